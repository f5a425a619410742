"""The soft matte: a face's skin over its box, sampled anywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.raster import Raster


@dataclass(frozen=True, eq=False)
class Matte:
    """The skin of one face in one frame.

    raster: square cells over the face's box, which may reach over the picture's edge;
    alpha: (h, w) uint8, 255 on skin;  mask: (h, w) bool.
    """

    raster: Raster
    alpha: Bytes
    mask: Bools

    @classmethod
    def over(cls, box: Floats, alpha: Bytes, mask: Bools | None = None) -> Matte:
        """The matte over a box (4,) float32 x0, y0, x1, y1, source pixels; skin is where alpha ≥ ½ unless a mask says.

        An asset keeps the box, so the raster is taken from it before as well as after.
        """
        h, w = alpha.shape
        return cls(Raster.over(box, (h, w)), alpha, alpha >= 128 if mask is None else mask)

    def crop(self, corner: Floats) -> Matte:
        """The same matte in the coordinates of a crop whose first pixel is `corner` (2,)."""
        return Matte(self.raster.crop(corner), self.alpha, self.mask)

    def mask_at(self, xs: Floats, ys: Floats) -> Bools:
        """The mask at the grid of source columns xs (w,) and rows ys (h,), as (h, w) bool; false outside the box."""
        inside: Bools = self.raster.read(self.mask.astype(np.float32), xs, ys) > 0.5
        return inside

    def alpha_at(self, xs: Floats, ys: Floats) -> Floats:
        """The matte in [0, 1] at source columns xs (w,) and rows ys (h,), as (h, w) float32; 0 outside the box."""
        return self.raster.read(np.asarray(self.alpha / np.float32(255), np.float32), xs, ys)
