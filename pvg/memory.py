"""How much memory a clip or picture will take, from its headers: neither its length nor its cuts count.

Data of the process (VmData), which is what a limit counts, at its peak; what is resident is a third less. Measured by
`python -m benchmarks.memory` on two cores with x264 and, of more than 8 bits, x265 at the default presets, 60 frames;
up to 1920×1080 150 frames, of 8 bits 4:2:0 300, by which vectorising takes its most. The rows of 3840×2160 in 4:4:4 and
of pictures are of before a row's body was looked for in a thread of its own (+60 MB). MB, and what is said:

| | vectorising | one look | three looks |
|---|---|---|---|
| 640×360, 8 bits 4:2:0 | 1177 (1248) | 677 (777) | 713 (907) |
| 640×360, 10 bits 4:2:0 | 1237 (1275) | 769 (1041) | 1126 (1717) |
| 640×360, 8 bits 4:4:4 | 1203 (1275) | 729 (814) | 801 (975) |
| 640×360, 10 bits 4:4:4 | 1254 (1331) | 836 (1093) | 1291 (1844) |
| 1920×1080, 8 bits 4:2:0 | 1445 (1469) | 1047 (1073) | 1379 (1447) |
| 1920×1080, 10 bits 4:2:0 | 1671 (1718) | 1499 (1613) | 3206 (3210) |
| 1920×1080, 8 bits 4:4:4 | 1664 (1718) | 1306 (1406) | 1889 (2053) |
| 1920×1080, 10 bits 4:4:4 | 2175 (2215) | 1989 (2079) | 4354 (4360) |
| 3840×2160, 8 bits 4:2:0 | 1759 (2215) | 2030 (2071) | 3103 (3266) |
| 3840×2160, 10 bits 4:2:0 | 2446 (3211) | 3470 (3541) | 8117 (8248) |
| 3840×2160, 8 bits 4:4:4 | 2369 (3211) | 2965 (3403) | 4977 (5692) |
| 3840×2160, 10 bits 4:4:4 | 3605 (5201) | 5031 (5408) | 12018 (12852) |
| picture of 8 MP | 1170 (1292) | 861 (1002) | 874 (1098) |
| picture of 32 MP | 1254 (1508) | 1838 (1938) | 1872 (2322) |

One look of 8 bits 4:2:0 by other encoders, at 1920×1080 and 3840×2160: HEVC 1172 (1380) and 2532 (2608), AV1 1337
(1378) and 2877 (3291), VP9 978 (1073) and 2055 (2071); DNxHR, FFV1 and ProRes less. Before the body's matte and people
were looked for, 7680×4320 took 5239 for one look.

Faces count little, since they share their threads and, where they are large, the pictures: with 16 of them, more than
are followed, vectorising took 1101 of 640×360, 1545 of 1920×1080 (8 bits 4:2:0) and 1215 of a picture of 2 MP, one look
561 of 640×360.

More processors encode more frames at once. Of what each beyond two adds for one look, by encoder, measured are with
eight in 640×360, 1920×1080 and 3840×2160: H.264 21, 68 and 168; HEVC of 8 bits 30 and 49 (the latter two), of 10 bits
24, 31 and 77; AV1 30, 109 and 372, and up to 509 with four; VP9 10, 12 and 22. What is refused is told by two, on any
machine; a pass uses as many as there is memory for (`processors_at_once`).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

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
    their encoders share.
    """
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
