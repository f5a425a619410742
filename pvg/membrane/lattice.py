"""The lattice of nodes over a face's box, and the coarser levels that the solver keeps of it.

All levels of a quantity lie in one flat array, one after the other, finest first. A level is a block of
(h + 2) × (w + 2) numbers with h and w even; its outer ring is zero, so that no loop needs a test at the border. A node
of a coarser level is the centre of a 2 × 2 block of the finer one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pvg._arrays import Floats, Ints

TARGET_HEIGHT = 208
"""Nodes along the height of a box: more cost time, fewer cost accuracy next to the curves. [measured: four 800x1096
faces against a direct solve at full size, medians of mean and p99 in levels: 184 nodes 0.09 and 1.1, 208 0.07 and 0.9,
224 0.07 and 0.8; time goes with their square]"""

_COARSEST = 4
"""A level whose shorter side has at most so many nodes is the last. [derived: few sweeps or a narrow band solve it]"""


@dataclass(frozen=True)
class Lattice:
    """Nodes over a box: node (row r, column c) lies at source pixel (x + c·step, y + r·step).

    The outer nodes enclose all pixel centres of the box, so reading a pixel of the box never extrapolates.

    Attributes:
        x, y: source pixel of the first node.
        step: distance of two nodes in source pixels, at least 1.
        width, height: number of nodes across and down, at least 2.
    """

    x: float
    y: float
    step: float
    width: int
    height: int

    @classmethod
    def over(cls, box: tuple[int, int, int, int], *, target_height: int = TARGET_HEIGHT) -> Lattice:
        """The lattice of a pixel box (x, y, width, height), some `target_height` nodes high, step ≥ 1.

        Raises:
            ValueError: the box holds no pixel, or fewer than two nodes are asked for.
        """
        x, y, width, height = box
        if width < 1 or height < 1 or target_height < 2:
            raise ValueError(f"a box of at least 1x1 pixels and 2 nodes is needed, got {box}, {target_height}")
        step = max(1.0, height / target_height)
        return cls(x, y, step, _nodes(width, step), _nodes(height, step))


def _nodes(pixels: int, step: float) -> int:
    """Nodes that span the centres of so many pixels."""
    return max(2, math.ceil((pixels - 1) / step - 1e-6) + 1)


def grid_levels(lattice: Lattice) -> Ints:
    """The levels of a lattice in a flat array: (L, 5) int64, (offset, h, w, rows, columns) of each, finest first.

    rows and columns count the nodes in use; h and w are those rounded up to even numbers. Each level has half the
    rows and columns of the one before it.
    """
    levels, offset, rows, columns = [], 0, lattice.height, lattice.width
    while True:
        h, w = rows + rows % 2, columns + columns % 2
        levels.append((offset, h, w, rows, columns))
        offset += (h + 2) * (w + 2)
        if min(rows, columns) <= _COARSEST:
            return np.array(levels, np.int64)
        rows, columns = h // 2, w // 2


def flat_size(levels: Ints) -> int:
    """Length N of a flat array over all levels."""
    offset, h, w, _, _ = levels[-1]
    return int(offset + (h + 2) * (w + 2))


def finest_nodes(flat: Floats, levels: Ints) -> Floats:
    """The (rows, columns) nodes of the lattice itself in an array over all levels, or in one of the finest level."""
    _, h, w, rows, columns = levels[0]
    return flat[: (h + 2) * (w + 2)].reshape(h + 2, w + 2)[1 : rows + 1, 1 : columns + 1]
