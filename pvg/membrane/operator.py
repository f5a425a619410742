"""The operator of eq. (1) for one face in one frame: set up once, solved for any number of right-hand sides."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from pvg._arrays import Floats
from pvg.errors import SolverError, UncutError
from pvg.membrane.edge_cuts import MIN_THETA, EdgeCuts
from pvg.membrane.equations import FivePoint, assemble, load_ties
from pvg.membrane.lattice import finest_nodes
from pvg.membrane.membrane import Membrane
from pvg.membrane.multigrid import solve

TOLERANCE = 1.0
"""Estimated largest error of a solve, in levels of 255. [measured: on faces the true one is below a quarter of it, and
the mean error below 0.005]"""

MAX_CYCLES = 40
"""Cycles after which a solve has failed. [measured: made-up faces take 3 for the default tolerance, 400 sets of random
curves at most 12 for a four-hundredth of it]"""

FINEST_TOLERANCE = 5e-6
"""Least tolerance, as a part of the range of the values. [derived: some forty units in the last place of float32]"""


@dataclass(frozen=True, eq=False)
class MembraneOperator:
    """The equations of one geometry with their grid hierarchy; made by `build_membrane`.

    Attributes:
        cuts: where γ cuts the lattice, E ties in all.
        weight: (E,) float32, what each tie adds to the load of its node.
        equations: the matrix on all levels.
        share: (4, N) float32, how much of a block's correction its children take, see `equations.assemble`.
    """

    cuts: EdgeCuts
    weight: Floats
    equations: FivePoint
    share: Floats

    def solve(self, values: ArrayLike, *, tolerance: float = TOLERANCE) -> Membrane:
        """The harmonic extension of `values` from γ into the box (eq. 1).

        Args:
            values: (S, C) finite, the values at the samples of γ; C is any number of channels (3 a look).
            tolerance: estimated largest error, in the units of the values; the true one was below it on faces and at
                most 10 times it on odd random curves.

        Raises:
            ValueError: another number of samples.
            SolverError: values that are not finite, a tolerance that is not met or too fine for float32.
        """
        cuts, lattice = self.cuts, self.cuts.lattice
        ties = cuts.values(values).T
        low, high = ties.min(axis=1, initial=np.inf), ties.max(axis=1, initial=-np.inf)
        if not np.isfinite(high - low).all():
            raise SolverError("the curve values hold NaN or infinity; check the colours of the curves")
        middle = 0.5 * (low + high)  # makes constants exact
        wanted = np.float32(tolerance)
        if ((high - low) * FINEST_TOLERANCE > wanted).any():
            raise SolverError(f"a tolerance of {wanted:g} is finer than float32 resolves; take {TOLERANCE}")
        planes = np.empty((len(ties), lattice.height, lattice.width), np.float32)
        size = self.share.shape[1]
        whole = _ones(size)
        for channel, plane in enumerate(planes):
            u, b = np.zeros(size, np.float32), np.empty(size, np.float32)
            load_ties(cuts.node, self.weight, ties[channel], middle[channel], b)
            solved, cycles, error = solve(u, b, self.equations, self.share, whole, cuts.levels, wanted, MAX_CYCLES)
            if not error <= wanted:
                raise SolverError(
                    f"the membrane of {lattice.width}x{lattice.height} nodes, channel {channel}, is off by about "
                    f"{error:.3g} levels after {cycles} cycles (wanted {wanted:g}); raise the tolerance"
                )
            np.add(finest_nodes(solved, cuts.levels), middle[channel], out=plane)
        return Membrane(lattice, planes)


def build_membrane(cuts: EdgeCuts) -> MembraneOperator:
    """Set up eq. (1) on a lattice whose edges γ cuts; one operator serves every right-hand side.

    Raises:
        UncutError: γ cuts no edge, so that there is no unique solution.
    """
    equations, share = assemble(cuts.theta, cuts.levels, MIN_THETA)
    if not finest_nodes(equations.tie, cuts.levels).any():
        raise UncutError("no curve crosses the lattice of the face's box; check the curve points and the box")
    # Coarser levels may hold a node more firmly than its own cuts do; its load follows.
    traced = np.bincount(cuts.node, cuts.weight, minlength=len(equations.tie))[cuts.node]
    weight = (cuts.weight * (equations.tie[cuts.node] / traced)).astype(np.float32)
    return MembraneOperator(cuts, weight, equations, share)


@lru_cache(maxsize=4)
def _ones(size: int) -> Floats:
    """(4, size) ones, made once for all channels and frames of a size."""
    return np.ones((4, size), np.float32)
