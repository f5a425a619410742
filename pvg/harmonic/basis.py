"""Harmonic B-splines on the leaves of a quadtree (eq. 2): basis functions, design matrix, Laplacian Λ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pvg._arrays import Doubles, Ints
from pvg._compiled import kernel
from pvg._threads import side_by_side
from pvg.harmonic.quadtree import Quadtree

_SUPPORT = 3.0  # leaf sizes at which ψ is truncated; its tail falls as r⁻⁴ [measured: ψ(3h) = −0.002 of ψ(0) = 0.68]
_BIN = 4.0  # side of a search bin in finest leaves [by eye]
_LEAST_SHARE = 2000  # points that are worth a thread [by eye]


class _Functions(NamedTuple):
    """Where the functions lie: centers (n, 2) and sizes (n,) of all leaves, radii (n_basis,) of the supports."""

    centers: Doubles
    sizes: Doubles
    radii: Doubles


class _Search(NamedTuple):
    """The functions that may reach each of some points.

    bins: (n_points,) the bin of each;  starts, members: the lists of the bins, see `HarmonicBasis`.
    """

    bins: Ints
    starts: Ints
    members: Ints


class _Stencils(NamedTuple):
    """Rows of w_ij of the leaves that carry functions (CSR)."""

    starts: Ints
    leaves: Ints
    weights: Doubles


class _Rows(NamedTuple):
    """Rows of a sparse matrix, a point each (CSR); columns and values are to be filled."""

    starts: Ints
    columns: NDArray[np.int32]
    values: Doubles


@kernel()
def _antiderivative(x: float, y: float) -> float:
    """F of eq. (2)'s Γ: ∂²F/∂x∂y = ln √(x² + y²)."""
    if x == 0.0 or y == 0.0:
        return 0.0
    angle = np.arctan(y / x)
    other = np.copysign(0.5 * np.pi, angle) - angle  # atan(x / y), without a second call
    return float(0.5 * (x * y * (np.log(x * x + y * y) - 3.0) + x * x * angle + y * y * other))


@kernel()
def _source_potential(x: float, y: float, h: float) -> float:
    """Γ of eq. (2), within 1e-8: the potential ln|x| / 2π at (x, y) of a unit charge spread over the square of side h.

    The square lies at the origin; a charge in a point would have a pole there.
    """
    square = x * x + y * y
    if square > 4.0 * h * h:
        # multipoles of the square; orders 4 and 8 leave less than 1e-8 beyond two sides
        z = complex(x, y) / h
        z4 = z * z * z * z
        inverse = 1.0 / z4
        multipoles: float = (inverse / 240.0 - inverse * inverse / 5760.0).real
        return float(0.5 * np.log(square) + multipoles) / (2.0 * np.pi)
    a = 0.5 * h
    total = (
        _antiderivative(x + a, y + a)
        - _antiderivative(x - a, y + a)
        - _antiderivative(x + a, y - a)
        + _antiderivative(x - a, y - a)
    )
    return total / (2.0 * np.pi * h * h)


@kernel()
def _count_bins(lows: Ints, highs: Ints, columns: int, counts: Ints) -> None:
    """Count the supports that reach each search bin; lows, highs: (n, 2) first and last bin of each, (x, y)."""
    for i in range(len(lows)):
        for by in range(lows[i, 1], highs[i, 1] + 1):
            for bx in range(lows[i, 0], highs[i, 0] + 1):
                counts[by * columns + bx] += 1


@kernel()
def _fill_bins(lows: Ints, highs: Ints, columns: int, cursor: Ints, members: Ints) -> None:
    """List the functions of each bin; cursor: where each bin's list begins, moved to its end."""
    for i in range(len(lows)):
        for by in range(lows[i, 1], highs[i, 1] + 1):
            for bx in range(lows[i, 0], highs[i, 0] + 1):
                b = by * columns + bx
                members[cursor[b]] = i
                cursor[b] += 1


@kernel()
def _count_rows(points: Doubles, functions: _Functions, search: _Search, counts: Ints) -> None:
    """Count the functions that are not zero at each point."""
    centers, _, radii = functions
    bins, starts, members = search
    for p in range(len(points)):
        for k in range(starts[bins[p]], starts[bins[p] + 1]):
            i = members[k]
            dx, dy = points[p, 0] - centers[i, 0], points[p, 1] - centers[i, 1]
            if dx * dx + dy * dy < radii[i] * radii[i]:
                counts[p] += 1


@kernel()
def _fill_rows(
    points: Doubles, functions: _Functions, search: _Search, stencils: _Stencils, rows: _Rows, first: int, last: int
) -> None:
    """Evaluate ψ at the points [first, last): columns and values of their rows."""
    centers, sizes, radii = functions
    bins, starts, members = search
    seen = np.full(len(centers), -1, dtype=np.int64)  # each Γ is computed once a point
    sources = np.empty(len(centers))
    for p in range(first, last):
        x, y = points[p, 0], points[p, 1]
        at = rows.starts[p]
        for k in range(starts[bins[p]], starts[bins[p] + 1]):
            i = members[k]
            dx, dy = x - centers[i, 0], y - centers[i, 1]
            if dx * dx + dy * dy >= radii[i] * radii[i]:
                continue
            if seen[i] != p:
                seen[i] = p
                sources[i] = _source_potential(dx, dy, sizes[i])
            value = 0.0
            for s in range(stencils.starts[i], stencils.starts[i + 1]):
                j = stencils.leaves[s]
                if seen[j] != p:
                    seen[j] = p
                    sources[j] = _source_potential(x - centers[j, 0], y - centers[j, 1], sizes[j])
                value += stencils.weights[s] * (sources[j] - sources[i])  # eq. (2): ψ_i = Σ_j w_ij (Γ_j − Γ_i)
            rows.columns[at] = i
            rows.values[at] = value
            at += 1


@dataclass(frozen=True)
class HarmonicBasis:
    """The functions ψ_i of a quadtree, ready to be evaluated; made by `harmonic_basis`.

    Attributes:
        tree: the leaves; the first `tree.n_basis` carry a function each.
        radii: (n_basis,) float64, where ψ_i is cut off, in pixels.
        stencil_starts, stencil_leaves, stencil_weights: rows of w_ij of the leaves that carry functions (CSR).
        bin_corner, bin_side, bin_shape: the search grid in pixels, (columns, rows).
        bin_starts, bin_members: functions whose support may reach each bin (CSR).
    """

    tree: Quadtree
    radii: Doubles
    stencil_starts: Ints
    stencil_leaves: Ints
    stencil_weights: Doubles
    bin_corner: Doubles
    bin_side: float
    bin_shape: tuple[int, int]
    bin_starts: Ints
    bin_members: Ints

    @property
    def n_basis(self) -> int:
        """Number of basis functions."""
        return len(self.radii)

    def values(self, points: NDArray[Any]) -> sparse.csr_array:
        """ψ_i(x) of eq. (2) before normalisation; points outside every support have empty rows.

        Args:
            points: (n_points, 2) float, (x, y) in pixels.

        Returns:
            (n_points, n_basis), sparse.

        Raises:
            ValueError: points of another shape, or not finite.
        """
        where = np.ascontiguousarray(points, dtype=np.float64)
        if where.ndim != 2 or where.shape[1] != 2 or not np.isfinite(where).all():
            raise ValueError(f"points must be finite and of shape (n, 2); got {where.shape}")
        columns, rows = self.bin_shape
        cell = np.clip(np.floor((where - self.bin_corner) / self.bin_side), 0, (columns - 1, rows - 1))
        bins = cell[:, 1].astype(np.int64) * columns + cell[:, 0].astype(np.int64)
        functions = _Functions(self.tree.centers, self.tree.sizes, self.radii)
        search = _Search(bins, self.bin_starts, self.bin_members)
        stencils = _Stencils(self.stencil_starts, self.stencil_leaves, self.stencil_weights)
        counts = np.zeros(len(where), dtype=np.int64)
        _count_rows(where, functions, search, counts)
        starts = _offsets(counts)
        found = _Rows(starts, np.empty(starts[-1], dtype=np.int32), np.empty(starts[-1]))

        def fill(first: int, last: int) -> None:
            _fill_rows(where, functions, search, stencils, found, first, last)

        half = len(where) // 2
        if half < _LEAST_SHARE:
            fill(0, len(where))
        else:
            side_by_side(lambda: fill(0, half), lambda: fill(half, len(where)))
        entries = (found.values, found.columns, starts.astype(np.int32))
        return sparse.csr_array(entries, shape=(len(where), self.n_basis))

    def design_matrix(self, points: NDArray[Any]) -> sparse.csr_array:
        """B of eq. (3): (n_points, n_basis), row = ψ_i(x) / Σ_j ψ_j(x), so that constants are exact.

        Args:
            points: (n_points, 2) float, (x, y) in pixels, on the domain or within one ring of it.

        Raises:
            ValueError: points as for `values`, or a point so far out that the functions no longer add up to one.
        """
        matrix = self.values(points)
        sums = np.asarray(matrix.sum(axis=1))
        if len(sums) and not np.abs(sums - 1.0).max() < 0.5:
            x, y = np.asarray(points)[np.abs(sums - 1.0).argmax()]
            raise ValueError(f"the point ({x:.1f}, {y:.1f}) lies outside the quadtree's domain")
        matrix.data /= np.repeat(sums, np.diff(matrix.indptr))
        return matrix


def harmonic_basis(tree: Quadtree) -> HarmonicBasis:
    """Stencils w_ij = ℓ_ij / d_ij, support radii and search bins of the functions of a quadtree (eq. 2)."""
    count = tree.n_basis
    weights = tree.lengths / tree.distances
    ends = np.concatenate([tree.pairs, tree.pairs[:, ::-1]])
    ends, weights = ends[ends[:, 0] < count], np.tile(weights, 2)[ends[:, 0] < count]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, weights = ends[order], weights[order]
    radii = _SUPPORT * tree.sizes[:count]
    return HarmonicBasis(
        tree,
        radii,
        _offsets(np.bincount(ends[:, 0], minlength=count)),
        ends[:, 1].copy(),
        weights,
        *_search_bins(tree.centers[:count], radii, _BIN * float(tree.sizes.min())),
    )


def laplacian_matrix(tree: Quadtree) -> sparse.csr_array:
    """Λ of eq. (3): (n_basis, n_basis) symmetric, off-diagonal w_ij = ℓ_ij / d_ij, rows sum to zero."""
    count = tree.n_basis
    inner = tree.pairs.max(axis=1) < count
    i, j = tree.pairs[inner].T
    weights = (tree.lengths / tree.distances)[inner]
    diagonal = np.bincount(i, weights, count) + np.bincount(j, weights, count)
    every = np.arange(count)
    entries = np.concatenate([weights, weights, -diagonal])
    where = (np.concatenate([i, j, every]), np.concatenate([j, i, every]))
    return sparse.csr_array(sparse.coo_array((entries, where), shape=(count, count)))


def _offsets(counts: NDArray[Any]) -> Ints:
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])


def _search_bins(centers: Doubles, radii: Doubles, side: float) -> tuple[Doubles, float, tuple[int, int], Ints, Ints]:
    corner = (centers - radii[:, None]).min(axis=0)
    lows = np.floor((centers - radii[:, None] - corner) / side).astype(np.int64)
    highs = np.floor((centers + radii[:, None] - corner) / side).astype(np.int64)
    columns, rows = (int(last) + 1 for last in highs.max(axis=0))
    counts = np.zeros(columns * rows, dtype=np.int64)
    _count_bins(lows, highs, columns, counts)
    starts = _offsets(counts)
    members = np.empty(starts[-1], dtype=np.int64)
    _fill_bins(lows, highs, columns, starts[:-1].copy(), members)
    return corner, side, (columns, rows), starts, members
