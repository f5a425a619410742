"""Pictures for people to see: frames over white, parts of them, scaled, as JPEG or PNG."""

from __future__ import annotations

from typing import Final, Literal

import cv2
import numpy as np

from pvg._arrays import Bytes
from pvg.video import Frame

Box = tuple[int, int, int, int]
"""x, y, width, height in pixels of the upright picture."""
PictureFormat = Literal["jpeg", "png"]

_AROUND: Final = 1.6  # side of a square around a face, in lengths of its longer side [by eye]
_JPEG: Final = (cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
_PNG: Final = (cv2.IMWRITE_PNG_COMPRESSION, 2)
_WHITE: Final = 255.0


def on_white(frame: Frame) -> Bytes:
    """(H, W, 3) uint8 RGB as an SDR display shows the frame, what is transparent over white."""
    rgb = frame.rgb()
    if frame.alpha is None:
        return rgb
    share = (frame.alpha / np.float32(2**frame.format.depth - 1))[..., None]
    return np.rint(rgb * share + np.float32(_WHITE) * (1 - share)).astype(np.uint8)


def around(box: Box) -> Box:
    """The square around a face with its hair and chin; it may lie beyond the picture in part."""
    x, y, width, height = box
    side = round(_AROUND * max(width, height))
    return x + (width - side) // 2, y + (height - side) // 2, side, side


def cropped(rgb: Bytes, box: Box | None) -> Bytes:
    """The part of a picture within a box, what lies beyond the picture left out.

    Raises `ValueError` when nothing of it is in the picture.
    """
    if box is None:
        return rgb
    x, y, width, height = box
    part = rgb[max(0, y) : max(0, y + height), max(0, x) : max(0, x + width)]
    if not part.size:
        raise ValueError(f"the crop {list(box)} lies outside of the picture of {rgb.shape[1]}x{rgb.shape[0]}")
    return part


def fitted(rgb: Bytes, max_width: int, max_height: int | None = None) -> Bytes:
    """The picture scaled down to fit, never up."""
    height, width = rgb.shape[:2]
    scale = min(1.0, max_width / width, 1.0 if max_height is None else max_height / height)
    if scale == 1.0:
        return rgb
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def thumbnail(rgb: Bytes, box: Box, size_px: int) -> Bytes:
    """A square box of a picture as (size_px, size_px, 3); beyond the picture its edge is repeated."""
    x, y, width, height = box
    part = cropped(rgb, box)
    rows, columns = rgb.shape[:2]
    borders = (max(0, -y), max(0, y + height - rows), max(0, -x), max(0, x + width - columns))
    square = cv2.copyMakeBorder(part, *borders, cv2.BORDER_REPLICATE) if any(borders) else part
    how = cv2.INTER_AREA if width > size_px else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(square, (size_px, size_px), interpolation=how), np.uint8)


def encoded(rgb: Bytes, encoding: PictureFormat) -> bytes:
    """The picture as a file, sRGB without metadata: JPEG of quality 90 with all its colour, or PNG."""
    suffix, options = (".jpg", _JPEG) if encoding == "jpeg" else (".png", _PNG)
    done, data = cv2.imencode(suffix, np.ascontiguousarray(rgb[..., ::-1]), options)
    if not done:
        raise ValueError(f"a picture of {rgb.shape[1]}x{rgb.shape[0]} cannot be written as {encoding}")
    return data.tobytes()
