"""How much memory a clip or picture will take, from its headers: neither its length nor its cuts count.

Counted is data of the process (VmData) at its peak, as a limit counts it; what is resident is a third less. Each bound
is what libraries, networks and threads take, and so many frames that are held at once; one look adds what its encoder
holds, by codec, and each processor beyond two encodes more frames at once. Faces count little: they share their threads
and, where they are large, the pictures. What is refused is told by two processors, on any machine; a pass uses as many
as there is memory for (`processors_at_once`). docs/performance/memory.md has what was measured.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from pvg._checks import whole_number
from pvg.video import MediaInfo

#: what does not depend on the frames: libraries, networks, threads
_VECTORIZING_BYTES, _RENDERING_BYTES = 1_220_000_000, 690_000_000
#: frames that are held on their way through vectorising
_VECTORIZED_FRAMES: Final = 80
#: pictures' worth of samples that a picture takes
_VECTORIZED_PICTURES, _DRAWN_PICTURES = 3, 13


class _Held(NamedTuple):
    """What a codec's encoders hold."""

    read: int  # frames between the decoder and all of them
    bytes: int  # of each, whatever the frame
    frames: int  # of each
    ahead: int  # bytes a pixel of each, whatever the samples: small luma pictures that HEVC looks ahead in
    more_bytes: int  # of each, for each processor that it has beyond those of a machine of two
    more_frames: float  # the same


_ENCODERS: Final = {
    "hevc": _Held(20, 280_000_000, 55, 85, 30_000_000, 3.5),
    "av1": _Held(20, 50_000_000, 185, 0, 35_000_000, 38.5),
}
_OTHERWISE: Final = _Held(63, 50_000_000, 44, 0, 35_000_000, 11)
#: processors that all of this was measured with
_MEASURED_WITH: Final = 2


def vectorizing_bytes(media: MediaInfo) -> int:
    """Bytes that `vectorize` takes at most."""
    held = _VECTORIZED_PICTURES if media.kind == "image" else _VECTORIZED_FRAMES
    return _VECTORIZING_BYTES + held * frame_bytes(media)


def rendering_bytes(media: MediaInfo, looks: int, codec: str = "auto", processors: int = _MEASURED_WITH) -> int:
    """Bytes that `render` takes at most with so many looks in one pass over the clip; a picture has them in one.

    codec: of the clips that are written, see `pvg.video.planned`; "auto" is for those in MP4. processors: that all of
    their encoders share. Raises `ValueError` for fewer than one of either.
    """
    looks, processors = whole_number("looks", looks, 1), whole_number("processors", processors, 1)
    if media.kind == "image":
        return _RENDERING_BYTES + (_DRAWN_PICTURES + 2 * (looks - 1)) * frame_bytes(media)
    if codec == "auto":
        codec = "h264" if media.format.depth == 8 else "hevc"
    held = _ENCODERS.get(codec, _OTHERWISE)
    one = held.bytes + held.frames * frame_bytes(media) + held.ahead * media.width * media.height
    more = max(0, max(1, processors // looks) - max(1, _MEASURED_WITH // looks))
    one += more * (held.more_bytes + int(held.more_frames * frame_bytes(media)))
    return _RENDERING_BYTES + held.read * frame_bytes(media) + looks * one


def looks_at_once(media: MediaInfo, memory_bytes: int, *, most: int, codec: str = "auto") -> int:
    """How many looks, from 1 to ``most``, are drawn in one pass within so many bytes."""
    fitting = (looks for looks in range(most, 1, -1) if rendering_bytes(media, looks, codec) <= memory_bytes)
    return next(fitting, 1)


def processors_at_once(media: MediaInfo, looks: int, memory_bytes: int, *, most: int, codec: str = "auto") -> int:
    """How many processors, of ``most``, the encoders of so many looks in one pass use within so many bytes.

    Two are used in any case, if there are.
    """
    fitting = (
        count
        for count in range(most, _MEASURED_WITH, -1)
        if rendering_bytes(media, looks, codec, count) <= memory_bytes
    )
    return next(fitting, min(most, _MEASURED_WITH))


def frame_bytes(media: MediaInfo) -> int:
    """Bytes of the samples of one frame as it is decoded; three samples a pixel for R, G, B."""
    across, down = media.format.chroma_log2
    samples = media.width * media.height * (1 + 2 / 2 ** (across + down))
    return int(samples * np.dtype(media.format.dtype).itemsize * (4 / 3 if media.has_alpha else 1))
