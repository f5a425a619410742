"""Made-up clips: pictures written so that they decode to the very planes they were given."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from benchmarks.quality.faces import Image


def even_side(picture: Image, scale: float) -> tuple[int, int]:
    """Width and height of a picture (h, w, …) so many times as large, rounded to even ones, as 4:2:0 asks for."""
    height, width = (round(side * scale) // 2 * 2 for side in picture.shape[:2])
    return width, height


def at_most(picture: Image, longest_px: int) -> Image:
    """A picture (h, w, 3) whose longer side has at most so many pixels, with even sides."""
    side = even_side(picture, min(1.0, longest_px / max(picture.shape[:2])))
    return np.asarray(cv2.resize(picture, side, interpolation=cv2.INTER_AREA), np.uint8)


def write_lossless(path: Path, frames: Iterator[Image]) -> None:
    """Write RGB frames as a clip that decodes to the very planes it was given."""
    with av.open(str(path), "w") as writer:
        stream = None
        for index, rgb in enumerate(frames):
            if stream is None:
                stream = writer.add_stream("libx264", rate=Fraction(25), options={"qp": "0", "preset": "veryfast"})
                stream.height, stream.width = rgb.shape[:2]
                stream.pix_fmt = "yuv420p"
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24").reformat(format="yuv420p")
            frame.pts, frame.time_base = index, Fraction(1, 25)
            writer.mux(stream.encode(frame))
        if stream is not None:
            writer.mux(stream.encode(None))
