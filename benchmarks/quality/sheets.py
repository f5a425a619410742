"""Contact sheets: strips of one case side by side, and sheets of the worst cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.quality.faces import Image
from pvg.video import read_image, write_image

TILE = 220
_BAR = 22


def _tile(picture: Image | None) -> Image:
    """The picture in a square of TILE pixels, grey around it."""
    out = np.full((TILE, TILE, 3), 90, np.uint8)
    if picture is None:
        return out
    h, w = picture.shape[:2]
    scale = TILE / max(h, w)
    size = (max(1, round(w * scale)), max(1, round(h * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    y, x = (TILE - size[1]) // 2, (TILE - size[0]) // 2
    out[y : y + size[1], x : x + size[0]] = small
    return out


def save_strip(path: Path, columns: Sequence[str], pictures: Mapping[str, Image]) -> None:
    """Write pictures in a row, one a column; a column without a picture stays grey."""
    write_image(path, np.concatenate([_tile(pictures.get(name)) for name in columns], axis=1))


def _bar(width: int, texts: Sequence[str]) -> Image:
    bar = np.full((_BAR, width, 3), 255, np.uint8)
    for i, text in enumerate(texts):
        latin = text.replace("λ", "lambda")  # the font has no Greek
        cv2.putText(bar, latin, (4 + i * TILE, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return bar


def save_sheet(path: Path, strips: Sequence[tuple[str, Path]], columns: Sequence[str]) -> None:
    """Write a sheet of captioned strips under a row of column names."""
    width = TILE * len(columns)
    rows = [_bar(width, columns)]
    for caption, strip in strips:
        rows += [_bar(width, [caption]), read_image(strip).rgb()]
    write_image(path, np.concatenate(rows))
