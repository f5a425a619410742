"""A 2:1-balanced quadtree over the face, refined at the diffusion curves (the paper's section on eq. 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import Delaunay

from pvg._arrays import Bools, Doubles, Ints
from pvg.raster import from_edge, to_edge

# Rings of leaves around the domain that carry basis functions. [measured: inside it the functions, not yet truncated,
# add up to 1 within 0.0023]
PADDING_RINGS = 2
STENCIL_RING = PADDING_RINGS + 1  # leaves that only complete the stencils of the last padding ring
_MAX_FINE_CELLS = 1 << 24  # of the raster the tree is cut from [derived: 134 MB of labels]


@dataclass(frozen=True)
class Quadtree:
    """The leaves near a domain and the Voronoi diagram of their centres.

    Leaves are ordered so that the `n_basis` leaves of rings 0 to 2 come first; ring 3 follows.

    Attributes:
        centers: (n, 2) float64, (x, y) in pixels.
        sizes: (n,) float64, side of each leaf square in pixels: h_min times a power of two.
        rings: (n,) int64; 0 touches the domain, 1 and 2 are padding, 3 only completes stencils.
        pairs: (m, 2) int64, i < j: leaves whose Voronoi cells share an edge of positive length.
        lengths: (m,) float64, length of that shared Voronoi edge in pixels.
        distances: (m,) float64, distance of the two centres in pixels.
        corner: (2,) float64, top left corner of the raster of finest cells, in pixels.
        cell: side of a finest cell, h_min, in pixels.
        labels: (rows, columns) int32, the leaf that covers each finest cell, -1 where none was kept.
    """

    centers: Doubles
    sizes: Doubles
    rings: Ints
    pairs: Ints
    lengths: Doubles
    distances: Doubles
    corner: Doubles
    cell: float
    labels: NDArray[np.int32]

    def locate(self, points: NDArray[Any]) -> NDArray[np.int32]:
        """The leaf that covers each of (n, 2) points (x, y) in pixels: (n,) int32, -1 where none was kept."""
        column, row = np.floor((np.asarray(points) - self.corner) / self.cell).astype(np.int64).T
        rows, columns = self.labels.shape
        within = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        leaf = self.labels[np.where(within, row, 0), np.where(within, column, 0)]
        return np.where(within, leaf, np.int32(-1))

    @property
    def n_basis(self) -> int:
        """Number of leaves that carry a basis function (rings 0 to 2)."""
        return int(np.count_nonzero(self.rings <= PADDING_RINGS))


@dataclass(frozen=True)
class _Grid:
    """The raster of finest cells that the tree is cut from: corner in pixels, shape in cells."""

    corner: Doubles
    cell: float
    shape: tuple[int, int]
    levels: int  # a leaf of level k has side cell * 2**k, k = 0 .. levels


def build_quadtree(
    curve_points: NDArray[Any],
    domain: Bools,
    *,
    h_min: float,
    h_max: float,
    origin: tuple[float, float] = (0.0, 0.0),
) -> Quadtree:
    """Cut the plane around `domain` into leaves: split while h > h_max, or h > h_min with a curve within h/2.

    The root side is h_min times a power of two; only the part of the tree near the domain is ever made.

    Args:
        curve_points: (S, 2) float, (x, y) in pixels, dense samples of the curves (spacing up to h_min).
        domain: (H, W) bool, the pixels of Ω; pixel centres at integer coordinates.
        h_min: side of the smallest leaf in pixels, > 0.
        h_max: upper bound on the side of a leaf in pixels, at least h_min.
        origin: (x, y) of domain[0, 0], for a mask that was cropped from its image.

    Raises:
        ValueError: empty domain, no or non-finite curve points, or sizes out of range.
    """
    points = np.asarray(curve_points, dtype=np.float64)
    if domain.ndim != 2 or domain.dtype != np.bool_ or not domain.any():
        raise ValueError("the domain must be a two-dimensional bool mask with at least one pixel set")
    if points.ndim != 2 or points.shape[1] != 2 or not len(points) or not np.isfinite(points).all():
        raise ValueError(f"curve points must be finite, at least one, of shape (S, 2); got {points.shape}")
    if not 0.0 < h_min <= h_max < np.inf:
        raise ValueError(f"leaf sizes must satisfy 0 < h_min <= h_max; got {h_min} and {h_max}")
    offset = np.asarray(origin, dtype=np.float64)
    grid = _place_grid(domain, offset, h_min, h_max)
    splits = _balance(_curve_splits((points - grid.corner) / h_min, grid))
    corners, sides, labels = _leaves(splits, grid)
    rings = _rings(corners, sides, labels, grid, domain, offset)
    # ring 4 is triangulated too, so that ring 3 hides the ragged hull from every stencil in use
    order = np.argsort(np.maximum(rings, PADDING_RINGS), kind="stable")
    order = order[: np.count_nonzero(rings <= STENCIL_RING + 1)]
    kept = int(np.count_nonzero(rings <= STENCIL_RING))
    names = np.full(len(rings), -1, dtype=np.int32)
    names[order[:kept]] = np.arange(kept, dtype=np.int32)
    centers = corners[order] + 0.5 * sides[order, None]
    pairs, weights = _voronoi_weights(centers)
    inner = pairs.max(axis=1) < kept
    pairs, weights = pairs[inner], weights[inner]
    distances = np.linalg.norm(centers[pairs[:, 0]] - centers[pairs[:, 1]], axis=1) * h_min
    return Quadtree(
        centers=grid.corner + centers[:kept] * h_min,
        sizes=sides[order[:kept]] * h_min,
        rings=rings[order[:kept]],
        pairs=pairs,
        lengths=weights * distances,
        distances=distances,
        corner=grid.corner,
        cell=grid.cell,
        labels=names[labels],
    )


def _place_grid(domain: Bools, offset: Doubles, h_min: float, h_max: float) -> _Grid:
    """Centre a raster of cells on the domain with room for four rings of the largest leaves."""
    rows, columns = np.flatnonzero(domain.any(axis=1)), np.flatnonzero(domain.any(axis=0))
    low = from_edge(np.array([columns[0], rows[0]], np.float64))
    high = from_edge(np.array([columns[-1] + 1, rows[-1] + 1], np.float64))
    levels = int(np.floor(np.log2(h_max / h_min) + 1e-9))
    top = 1 << levels
    blocks = np.ceil((high - low) / (h_min * top)) + 2 * (STENCIL_RING + 2)
    if np.prod(blocks) * top * top > _MAX_FINE_CELLS:
        raise ValueError(f"h_min = {h_min} px is too small for a domain of {domain.shape[1]}×{domain.shape[0]} px")
    cells = blocks.astype(np.int64) * top
    corner = offset + (low + high - cells * h_min) / 2
    return _Grid(corner, h_min, (int(cells[1]), int(cells[0])), levels)


def _curve_splits(points: Doubles, grid: _Grid) -> list[Bools]:
    """Cells of each level that a curve passes within h/2 of; points in units of the finest cell."""
    splits = [np.zeros(grid.shape, dtype=bool)]  # the finest cells are never split
    for level in range(1, grid.levels + 1):
        side = 1 << level
        rows, columns = grid.shape[0] // side, grid.shape[1] // side
        split = np.zeros((rows, columns), dtype=bool)
        local = points / side
        base = np.floor(local)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                cell = base + np.array((dx, dy))
                gap = np.maximum(np.abs(local - cell - 0.5) - 0.5, 0.0)
                near = (gap**2).sum(axis=1) <= 0.25
                near &= (cell >= 0).all(axis=1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
                x, y = cell[near].astype(np.int64).T
                split[y, x] = True
        splits.append(split)
    return splits


def _balance(splits: list[Bools]) -> list[Bools]:
    """Split further until edge neighbours differ by at most one level; one sweep from fine to coarse."""
    balanced = splits[:2]
    for level in range(1, len(splits) - 1):
        # a split cell needs edge neighbours of its own level, hence split parents of those
        needed = binary_dilation(balanced[level])
        rows, columns = splits[level + 1].shape
        balanced.append(splits[level + 1] | needed.reshape(rows, 2, columns, 2).any(axis=(1, 3)))
    return balanced


def _leaves(splits: list[Bools], grid: _Grid) -> tuple[Doubles, Doubles, Ints]:
    """Corners (n, 2) and sides (n,) of the leaves in finest cells, and the leaf index of every finest cell."""
    corners, sides = [], []
    labels = np.full(grid.shape, -1, dtype=np.int64)
    count = 0
    for level in range(grid.levels, -1, -1):
        side = 1 << level
        leaf = ~splits[level]
        if level < grid.levels:
            leaf &= _refine(splits[level + 1], 2)
        y, x = np.nonzero(leaf)
        index = np.full(leaf.shape, -1, dtype=np.int64)
        index[y, x] = np.arange(count, count + len(x))
        np.maximum(labels, _refine(index, side), out=labels)
        corners.append(np.stack([x, y], axis=1) * float(side))
        sides.append(np.full(len(x), float(side)))
        count += len(x)
    return np.concatenate(corners), np.concatenate(sides), labels


def _refine(values: NDArray[Any], factor: int) -> NDArray[Any]:
    return values.repeat(factor, axis=0).repeat(factor, axis=1)


def _rings(corners: Doubles, sides: Doubles, labels: Ints, grid: _Grid, domain: Bools, offset: Doubles) -> Ints:
    """Ring of each leaf around the domain: 0 touches a pixel square of it, up to 4; 5 for everything beyond."""
    start = to_edge(corners * grid.cell + grid.corner - offset)
    stop = start + sides[:, None] * grid.cell
    table = np.zeros((domain.shape[0] + 1, domain.shape[1] + 1), dtype=np.int64)
    np.cumsum(np.cumsum(domain, axis=0, dtype=np.int64), axis=1, out=table[1:, 1:])
    bound = np.array([domain.shape[1], domain.shape[0]])
    x0, y0 = np.clip(np.floor(start), 0, bound).astype(np.int64).T
    x1, y1 = np.clip(np.ceil(stop), 0, bound).astype(np.int64).T
    reached = table[y1, x1] - table[y0, x1] - table[y1, x0] + table[y0, x0] > 0
    last = STENCIL_RING + 1
    rings = np.full(len(sides), last + 1, dtype=np.int64)
    rings[reached] = 0
    for ring in range(1, last + 1):
        grown = binary_dilation(reached[labels], structure=np.ones((3, 3), dtype=bool))
        touched = np.zeros_like(reached)
        touched[labels[grown]] = True
        rings[touched & ~reached] = ring
        reached = touched
    return rings


def _voronoi_weights(centers: Doubles) -> tuple[Ints, Doubles]:
    """Pairs i < j and ℓ_ij / d_ij of the Voronoi diagram: half the cotangents opposite a Delaunay edge.

    True Voronoi edges close around every leaf (Σ_j ℓ_ij n_ij = 0), so the stencil of a graded leaf has no dipole
    moment and linear functions are in the kernel of Λ; lengths of the squares' shared sides have neither property.
    """
    triangles = Delaunay(centers).simplices.astype(np.int64)
    keys, halves = [], []
    for corner in range(3):
        apex, i, j = (triangles[:, (corner + step) % 3] for step in range(3))
        a, b = centers[i] - centers[apex], centers[j] - centers[apex]
        area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        keys.append(np.minimum(i, j) * len(centers) + np.maximum(i, j))
        halves.append(0.5 * (a * b).sum(axis=1) / area)
    key, where = np.unique(np.concatenate(keys), return_inverse=True)
    weights: Doubles = np.bincount(where, weights=np.concatenate(halves)).astype(np.float64)
    shared = weights > 1e-9  # four cocircular centres: the diagonal has no Voronoi edge
    return np.stack(np.divmod(key[shared], len(centers)), axis=1), weights[shared]
