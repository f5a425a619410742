"""One sheet: the reference's face, and two results without names, as full frames and face crops."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from benchmarks.quality.faces import Image

SIZE = (1500, 1000)  # width, height
_GROUND = 128
_SIDE = 270  # width of the reference's column
_GAP = 6
_FULL_SHARE = 0.42  # of a strip's height for its full frames
_TEXT = 1.1


def put(sheet: Image, picture: Image, box: tuple[int, int, int, int]) -> None:
    """Lay a picture into the middle of a box (x, y, width, height), as large as fits."""
    x, y, width, height = box
    h, w = picture.shape[:2]
    scale = min(width / w, height / h)
    size = (max(1, round(w * scale)), max(1, round(h * scale)))
    fitted = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    left, top = x + (width - size[0]) // 2, y + (height - size[1]) // 2
    sheet[top : top + size[1], left : left + size[0]] = fitted


def write(sheet: Image, text: str, at: tuple[int, int]) -> None:
    """Write white letters with a dark rim, their lower left corner at a pixel (x, y)."""
    cv2.putText(sheet, text, at, cv2.FONT_HERSHEY_SIMPLEX, _TEXT, (0, 0, 0), 6, cv2.LINE_AA)
    cv2.putText(sheet, text, at, cv2.FONT_HERSHEY_SIMPLEX, _TEXT, (255, 255, 255), 2, cv2.LINE_AA)


def draw_sheet(
    number: int,
    reference: Image,
    sides: tuple[Sequence[Image], Sequence[Image]],
    crops: Sequence[tuple[slice, slice]],
) -> Image:
    """(1000, 1500, 3): the reference on the left; of one frame A beside B, of several a strip of A above one of B."""
    width, height = SIZE
    sheet = np.full((height, width, 3), _GROUND, np.uint8)
    put(sheet, reference, (_GAP, 70, _SIDE - 2 * _GAP, _SIDE))
    write(sheet, f"No {number}", (_GAP + 4, 50))
    write(sheet, "reference", (_GAP + 4, 110 + _SIDE))
    count, room = len(crops), width - _SIDE
    for k, (side, pictures) in enumerate(zip("AB", sides, strict=True)):
        if count == 1:
            column, half = room // 2, height // 2
            x = _SIDE + k * column
            put(sheet, pictures[0], (x, 0, column - _GAP, half - _GAP))
            put(sheet, pictures[0][crops[0]], (x, half, column - _GAP, half))
            write(sheet, side, (x + 8, 36))
            continue
        column, row = room // count, height // 2
        top, full = k * row, round(_FULL_SHARE * row)
        for i, (picture, crop) in enumerate(zip(pictures, crops, strict=True)):
            x = _SIDE + i * column
            put(sheet, picture, (x, top, column - _GAP, full - _GAP))
            put(sheet, picture[crop], (x, top + full, column - _GAP, row - full - _GAP))
        write(sheet, side, (_SIDE - 34, top + (40 if k else row - 40)))
    return sheet
