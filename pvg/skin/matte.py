"""The soft matte: a face's skin over its box, sampled anywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg.rendering._planes import read_grid
from pvg.skin.prior import Bools, Bytes, Floats


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
