"""Soft covers: how much of each cell a polygon of a face's features covers."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.raster import SUBPIXEL_BITS, fixed_point, scaled

_FINER = 4  # polygons are drawn this many times finer than their cells
_WIDE = 5.0  # cells of blur from which on half of that will do; what closes, eyes and mouths, is blurred less
_REACH = 3.0  # spreads of the blur after which next to nothing is left of a cover


def soft_cover(
    polygon: Floats, sigma: float, within: tuple[int, int], hole: Floats | None = None
) -> tuple[Floats, tuple[int, int]]:
    """The share of each cell that a polygon covers, blurred: (h, w) float32 in [0, 1], and its first cell's x and y.

    polygon: (n, 2) in cells;  sigma: of the blur, cells;  within: rows and columns of the cells that are asked for,
    from the origin on;  hole: (m, 2) what is not of it. Of cells asked for that are not returned the cover is 0. Of
    others some are made: OpenCV draws an edge that it cuts off a little elsewhere, so those of features are left whole,
    and only what is farther from the cells than they are wide is cut off. The cover goes as lips and lids close: OpenCV
    draws every polygon a pixel too wide, so that closed ones would keep a cover, and trembles; drawn finer, both are
    too small to see.
    """
    asked = np.array(within[::-1])
    reach = min(int(np.ceil(_REACH * sigma)), int(asked.max()))
    low = np.maximum(np.floor(polygon.min(axis=0)).astype(int), -asked) - reach
    high = np.minimum(np.ceil(polygon.max(axis=0)).astype(int), 2 * asked) + reach + 1
    columns, rows = (int(n) for n in high - low)
    if columns <= 0 or rows <= 0:
        return np.zeros((0, 0), np.float32), (int(low[0]), int(low[1]))
    times = _FINER // 2 if sigma >= _WIDE else _FINER
    finer = np.zeros((rows * times, columns * times), np.uint8)
    _fill(finer, polygon - low.astype(np.float32), 255, times)
    if hole is not None:
        _fill(finer, hole - low.astype(np.float32), 0, times)
    covered = cv2.resize(finer, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32) / np.float32(255.0)
    side = 2 * reach + 1
    soft = cv2.GaussianBlur(covered, (side, side), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(soft, np.float32), (int(low[0]), int(low[1]))


def _fill(finer: Bytes, polygon: Floats, level: int, times: int) -> None:
    cv2.fillPoly(finer, [fixed_point(scaled(polygon, float(times)))], (level,), shift=SUBPIXEL_BITS)
