"""The soft matte: a face's skin over its box, sampled anywhere, and the edge filter that makes masks soft."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._planes import read_grid
from pvg.skin.zones import Bools, Bytes, Floats

_SOFT_RADIUS = 0.030  # of the face's width: reach of the guided filter, so of the soft edge
_SOFT_EPS = 200.0  # squared 8-bit levels: weaker edges of the picture do not hold the matte's edge


@dataclass(frozen=True, eq=False)
class Matte:
    """The skin of one face in one frame, over its box.

    box: (4,) float32 x0, y0, x1, y1, source pixels, may reach over the picture's edge;
    alpha: (h, w) uint8, 255 on skin;  mask: (h, w) bool.
    Both rasters cover the box evenly with square cells: cell (r, c) is centred at x0 + (c + ½) step − ½,
    y0 + (r + ½) step − ½.
    """

    box: Floats
    alpha: Bytes
    mask: Bools

    @property
    def step(self) -> float:
        """Source pixels a cell."""
        return float(self.box[2] - self.box[0]) / int(self.mask.shape[1])

    def to_raster(self, points: Floats) -> Floats:
        """Cell coordinates (n, 2) x, y of source positions (n, 2); cell centres are at integers."""
        cells: Floats = ((points - self.box[:2] + 0.5) / self.step - 0.5).astype(np.float32)
        return cells

    def mask_at(self, xs: Floats, ys: Floats) -> Bools:
        """The mask at the grid of source columns xs (w,) and rows ys (h,), as (h, w) bool; false outside the box."""
        inside: Bools = self._sample(self.mask.astype(np.float32), xs, ys) > 0.5
        return inside

    def alpha_at(self, xs: Floats, ys: Floats) -> Floats:
        """The matte in [0, 1] at source columns xs (w,) and rows ys (h,), as (h, w) float32; 0 outside the box."""
        return self._sample(np.asarray(self.alpha / np.float32(255), np.float32), xs, ys)

    def _sample(self, raster: Floats, xs: Floats, ys: Floats) -> Floats:
        step = self.step
        padded = np.pad(raster, 1)
        rows = (np.asarray(ys, np.float64) - self.box[1] + 0.5) / step + 0.5
        columns = (np.asarray(xs, np.float64) - self.box[0] + 0.5) / step + 0.5
        out = np.empty((len(rows), len(columns)), np.float32)
        read_grid(padded, columns, rows, out)
        return out


def soft_matte(rgb: Bytes, mask: Bools, *, face_width: float) -> Floats:
    """Soft matte of a mask: 1 well inside, 0 a few pixels outside, following the picture's edges between.

    rgb: (H, W, 3) uint8;  mask: (H, W) bool;  face_width: pixels.  Returns (H, W) float32 in [0, 1].
    """
    return soften(rgb, mask.astype(np.float32), max(1, round(_SOFT_RADIUS * face_width)))


def soften(rgb: Bytes, skin: Floats, radius: int) -> Floats:
    """Guided filter of skin (h, w) in [0, 1], held to 1 inside and 0 outside a band of `radius` about its edge."""
    filtered = cv2.ximgproc.guidedFilter(rgb, np.ascontiguousarray(skin, np.float32), radius, _SOFT_EPS)
    # the filter spreads a faint veil over everything within its window: cut it, and what it took from the inside
    stretched = np.clip((filtered - 0.06) / 0.88, 0, 1)
    distance = cv2.GaussianBlur(skin, (0, 0), max(0.5, radius / 2))
    alpha = np.where(distance < 0.02, 0.0, np.where(distance > 0.98, 1.0, stretched))
    out: NDArray[np.float32] = alpha.astype(np.float32)
    return out
