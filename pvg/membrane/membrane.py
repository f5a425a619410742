"""A solved membrane: smooth away from γ, so it lives on the lattice and is read bilinearly at source pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pvg._arrays import Floats
from pvg._bilinear import read_grid
from pvg.membrane.lattice import Lattice


@dataclass(frozen=True, eq=False)
class Membrane:
    """The harmonic extension H(d) of values d on γ into a box (eq. 1), at the nodes of its lattice.

    Attributes:
        lattice: the nodes, w across and h down.
        planes: (C, h, w) float32, in the units of the curve values.
    """

    lattice: Lattice
    planes: Floats

    def read(self, xs: ArrayLike, ys: ArrayLike) -> Floats:
        """Values over the product of source coordinates; a part reads the same numbers as the whole.

        Args:
            xs, ys: 1-D source coordinates in pixels, ascending; those outside the lattice repeat its border. For
                chroma planes at half size pass the chroma sites.

        Returns:
            (C, len(ys), len(xs)) float32.
        """
        columns = (np.asarray(xs, np.float64) - self.lattice.x) / self.lattice.step
        rows = (np.asarray(ys, np.float64) - self.lattice.y) / self.lattice.step
        out = np.empty((len(self.planes), len(rows), len(columns)), np.float32)
        for plane, to in zip(self.planes, out, strict=True):
            read_grid(plane, columns, rows, to)
        return out

    def on(self, lattice: Lattice) -> Membrane:
        """The same, read at the nodes of another lattice."""
        xs = lattice.x + lattice.step * np.arange(lattice.width)
        ys = lattice.y + lattice.step * np.arange(lattice.height)
        return Membrane(lattice, self.read(xs, ys))

    def crop(self, x: int, y: int, width: int, height: int) -> Floats:
        """The pixels [x, x + width) × [y, y + height) of the source: (height, width, C) float32."""
        read = self.read(np.arange(x, x + width), np.arange(y, y + height))
        return np.moveaxis(read, 0, -1)
