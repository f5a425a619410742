"""The 5-point equations of eq. (1) on every level of the lattice, and their right-hand side.

The equation of a node u with uncut neighbours v and cut edges (θ, g),

    Σ_v (v − u) + Σ_cuts (g − u) / θ = 0,                                                                   eq. (1)

is that of the membrane (f = 0: the Laplacian of the frame stays in the frame). They form a symmetric positive definite
M-matrix: the solution is linear in g and lies between the least and the greatest g. Only neighbours on the lattice
enter, so a border of the box without a curve has zero flux.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats, Ints
from pvg._compiled import kernel


class FivePoint(NamedTuple):
    """The matrix A of `diagonal · u − Σ edge · neighbour = b` on all levels; arrays of (N,) float32, see `lattice`.

    east, south: weights of the edges to the right and down, 1 or, where γ cuts the edge, 0.
    tie: the sum of 1/θ over a node's cut edges.
    diagonal, inverse_diagonal: the sum of all four edges and the tie, and its reciprocal, 0 where no node lies.
    """

    east: Floats
    south: Floats
    tie: Floats
    diagonal: Floats
    inverse_diagonal: Floats


@kernel()
def assemble(theta: Floats, levels: Ints, min_theta: np.float32) -> tuple[FivePoint, Floats]:
    """The equations of every level, and how a block shares its correction among its children.

    theta: (4, N), see `EdgeCuts`;  min_theta: lower bound of θ.
    Returns A and share: (4, N), the parts of its correction that the children to the right, left, below and above of
    a block's centre take. A correction falls linearly to zero at a cut, so a child a quarter step away keeps 1 − ¼/θ.
    """
    size = theta.shape[1]
    east, south, tie = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)
    diagonal, inverse_diagonal = np.zeros(size, np.float32), np.zeros(size, np.float32)
    share = np.ones((4, size), np.float32)
    one, none = np.float32(1.0), np.float32(0.0)
    for level in range(len(levels)):
        offset, _, w, rows, columns = levels[level]
        fine, wf = levels[max(level - 1, 0), 0], levels[max(level - 1, 0), 2]
        for y in range(rows):
            for x in range(columns):
                i = offset + (y + 1) * (w + 2) + x + 1
                east[i] = one if x + 1 < columns and theta[0, i] == np.inf else none
                south[i] = one if y + 1 < rows and theta[2, i] == np.inf else none
                for side in range(4):
                    if theta[side, i] < np.inf:
                        weight = one / max(theta[side, i], min_theta)
                        tie[i] += weight
                        share[side, i] = max(none, one - np.float32(0.25) * weight)
                if level > 0:
                    # A curve that runs between the children, unseen from their centre, must hold the block as
                    # firmly as it holds them: else the correction of the block overshoots and diverges.
                    k = fine + (2 * y + 1) * (wf + 2) + 2 * x + 1
                    right, left, low, up = share[0, i] ** 2, share[1, i] ** 2, share[2, i] ** 2, share[3, i] ** 2
                    upper = left * tie[k] + right * tie[k + 1]
                    lower = left * tie[k + wf + 2] + right * tie[k + wf + 3]
                    tie[i] = max(tie[i], up * upper + low * lower)
                # eq. (1); the edges to the left and above belong to nodes already done
                diagonal[i] = east[i] + east[i - 1] + south[i] + south[i - w - 2] + tie[i]
                inverse_diagonal[i] = one / diagonal[i]
    return FivePoint(east, south, tie, diagonal, inverse_diagonal), share


@kernel(fastmath=True)
def load_ties(node: NDArray[np.intp], weight: Floats, values: Floats, middle: np.float32, b: Floats) -> None:
    """b = Σ weight · (value − middle) over the ties of each node: the right-hand side of eq. (1), on all levels."""
    b[:] = np.float32(0.0)
    for e in range(len(node)):
        b[node[e]] += weight[e] * (values[e] - middle)
