"""Square regions of a picture, turned, and read at the size that a network takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Bytes, Doubles
from pvg.picture import Picture
from pvg.raster import scaled_affine


@dataclass(frozen=True)
class Region:
    """A square of the picture turned so that something in it is upright.

    center_x, center_y, size: source pixels; angle: radians, positive when a level line of it falls to the right.
    """

    center_x: float
    center_y: float
    size: float
    angle: float

    def to_source(self, pixels: int) -> Doubles:
        """(2, 3) affine map to source pixel centres of the centres of its pixels, if it has so many a side."""
        scale = self.size / pixels
        cos, sin = scale * np.cos(self.angle), scale * np.sin(self.angle)
        middle = (pixels - 1) / 2
        return np.array(
            [
                [cos, -sin, self.center_x - middle * (cos - sin)],
                [sin, cos, self.center_y - middle * (sin + cos)],
            ]
        )

    def read(self, picture: Picture, pixels: int) -> Bytes:
        """What a picture shows there, (pixels, pixels, 3) uint8 RGB; a large one is averaged down first.

        Beyond the picture its edge is repeated.
        """
        to_source = self.to_source(pixels)
        if self.size < 2 * pixels:
            return picture.warp(to_source, (pixels, pixels))
        corners = to_source @ np.array([[0, pixels, 0, pixels], [0, 0, pixels, pixels], [1, 1, 1, 1]], np.float64)
        x0, y0 = (int(value) for value in np.floor(corners.min(axis=1)))
        x1, y1 = (int(value) for value in np.ceil(corners.max(axis=1)) + 1)
        part = picture.part((x0, y0, x1, y1))
        small, factor = part.reduced(self.size / pixels)
        to_small = to_source.copy()
        to_small[:, 2] -= part.box[:2]
        return small.warp(scaled_affine(to_small, 1.0 / factor), (pixels, pixels))
