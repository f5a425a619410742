"""Compiled kernels that read coarse grids bilinearly.

A grid is first stretched along its own rows, of which there are few, so that what is done for every sample runs along
contiguous memory and vectorises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg._compiled import kernel


@kernel(fastmath=True)
def split(places: Doubles, count: int) -> tuple[NDArray[np.int32], Floats]:
    """Positions as the node before and the way to the next; those outside a grid of `count` are clamped."""
    index, share = np.empty(len(places), np.int32), np.empty(len(places), np.float32)
    for j in range(len(places)):
        place = min(max(places[j], 0.0), count - 1.0)
        index[j] = min(int(place), count - 2)
        share[j] = place - index[j]
    return index, share


@kernel(fastmath=True)
def _stretch(row: Floats, index: NDArray[np.int32], share: Floats, out: Floats) -> None:
    """out[j] = the row of a grid between its nodes index[j] and index[j] + 1."""
    for j in range(len(out)):
        k = index[j]
        out[j] = row[k] + share[j] * (row[k + 1] - row[k])


@kernel(fastmath=True)
def reach(plane: Floats, upper: int, at: int, index: NDArray[np.int32], share: Floats, wide: Floats) -> int:
    """Have the stretched rows `upper` and `upper` + 1 in `wide` (2, n), where row `at` and the next were; in order.

    Nothing is to be done, and it is not to be called, where `upper` is `at`: a call costs as much as a hundred samples.
    """
    if upper == at + 1:
        wide[0] = wide[1]
    else:
        _stretch(plane[upper], index, share, wide[0])
    _stretch(plane[upper + 1], index, share, wide[1])
    return upper


@kernel(fastmath=True)
def read_grid(plane: Floats, columns: Doubles, rows: Doubles, out: Floats) -> None:
    """out[i, j] = the bilinear value of plane at (columns[j], rows[i]), in nodes; positions outside are clamped."""
    h, w = plane.shape
    (index, share), (upper, down) = split(columns, w), split(rows, h)
    wide, at = np.empty((2, len(columns)), np.float32), -2
    for i in range(len(rows)):
        if upper[i] != at:
            at = reach(plane, upper[i], at, index, share, wide)
        f, a, b, to = down[i], wide[0], wide[1], out[i]
        for j in range(len(to)):
            to[j] = a[j] + f * (b[j] - a[j])
