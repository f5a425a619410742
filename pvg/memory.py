"""How much memory a clip or picture will take, from its headers.

Data of the process (VmData), which is what a limit counts, at its peak; what is resident is a third less. Measured on
two cores with x264, x265 and SVT-AV1 at the default presets, 48 to 60 frames (7680×4320: 24). MB, and what is said:

| 8 bits 4:2:0 | vectorising | one look | three looks | AV1 | HEVC |
|---|---|---|---|---|---|
| 640×360 | 882 (962) | 494 (588) | | | |
| 1920×1080 | 1010 (1062) | 828 (892) | 1171 (1234) | 1132 (1188) | 946 (1017) |
| 3840×2160 | 1320 (1398) | 1722 (1919) | 2864 (3287) | | |
| 7680×4320 | 1919 (2742) | 5239 (6024) | | | |
| picture of 8 MP | 903 (1022) | 699 (790) | | | |
| picture of 32 MP | 991 (1238) | | | | |

Of 10 bits and 4:4:4 nothing is measured: frames count by their bytes. More cores decode and encode more frames at once,
so that there it takes more.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pvg.video import MediaInfo

#: what does not depend on the frames: libraries, networks, threads
_VECTORIZING_BYTES, _RENDERING_BYTES = 950_000_000, 550_000_000
#: frames that are held: on their way through vectorising; from the decoder to the encoders; in an encoder, by its codec
_VECTORIZED_FRAMES: Final = 36
_READ_FRAMES: Final = 55
_ENCODED_FRAMES: Final = {"av1": 150, "hevc": 95}
_OTHERWISE: Final = 55
#: pictures' worth of samples that a picture takes
_VECTORIZED_PICTURES, _DRAWN_PICTURES = 3, 10


def vectorizing_bytes(media: MediaInfo) -> int:
    """Bytes that `vectorize` takes at most."""
    held = _VECTORIZED_PICTURES if media.kind == "image" else _VECTORIZED_FRAMES
    return _VECTORIZING_BYTES + held * frame_bytes(media)


def rendering_bytes(media: MediaInfo, looks: int, codec: str = "auto") -> int:
    """Bytes that `render` takes at most with so many looks in one pass over the clip; a picture has them in one."""
    if media.kind == "image":
        return _RENDERING_BYTES + (_DRAWN_PICTURES + 2 * (looks - 1)) * frame_bytes(media)
    if codec == "auto":
        codec = "h264" if media.format.depth == 8 else "hevc"
    return _RENDERING_BYTES + (_READ_FRAMES + looks * _ENCODED_FRAMES.get(codec, _OTHERWISE)) * frame_bytes(media)


def looks_at_once(media: MediaInfo, memory_bytes: int, *, most: int, codec: str = "auto") -> int:
    """How many looks, from 1 to ``most``, are drawn in one pass within so many bytes."""
    fitting = (looks for looks in range(most, 1, -1) if rendering_bytes(media, looks, codec) <= memory_bytes)
    return next(fitting, 1)


def frame_bytes(media: MediaInfo) -> int:
    """Bytes of the samples of one frame as it is decoded; three samples a pixel for R, G, B."""
    across, down = media.format.chroma_log2
    samples = media.width * media.height * (1 + 2 / 2 ** (across + down))
    return int(samples * np.dtype(media.format.dtype).itemsize * (4 / 3 if media.has_alpha else 1))
