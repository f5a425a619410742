"""The membrane: the harmonic extension H(d) of values d on the diffusion curves γ into a box (eq. 1).

A membrane is smooth away from γ, so it is solved on a coarse lattice of nodes and read off bilinearly at source
pixels. The curves stay sharp on that lattice: instead of blackening nodes, every lattice edge that γ crosses is
cut at the crossing and each of its ends is tied to the value of γ there at its true distance θ. The two sides of a
curve are thereby separated exactly, and the positions of the curves are not rounded.

The 5-point equations of a node u with uncut neighbours v and cut edges (θ, g),

    Σ_v (v − u) + Σ_cuts (g − u) / θ = 0,

form a symmetric M-matrix: the solution is linear in g and lies between the least and the greatest g. Only
neighbours inside the domain enter, so a border of the domain without a curve has zero flux.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pvg._bilinear import read_grid
from pvg.errors import SolverError
from pvg.membrane import multigrid

Floats = NDArray[np.float32]
Layout = Sequence[tuple[int, int, bool]]

TARGET_HEIGHT = 208
"""Nodes along the height of a box: more cost time, fewer cost accuracy next to the curves. [measured on four 800x1096
faces against a direct solve at full size, medians of mean and p99 in levels: 184 nodes 0.09 and 1.1, 208 0.07 and 0.9,
224 0.07 and 0.8; time goes with their square]"""

TOLERANCE = 1.0
"""Estimated largest error of a solve, in levels of 255. [measured on faces: the true one is below a quarter of it, and
the mean error below 0.005]"""

MAX_CYCLES = 40

FINEST = 5e-6
"""Least tolerance, as a part of the range of the values."""

MIN_THETA = np.float32(0.001)
"""A node on a curve is tied by 1/θ = 1000 at most; what leaks through it to the other side is below a thousandth."""


@dataclass(frozen=True)
class Lattice:
    """Nodes over a box: node (row r, column c) lies at source pixel (x + c·step, y + r·step).

    The outer nodes enclose all pixel centres of the box, so reading a pixel of the box never extrapolates.
    """

    x: float
    y: float
    step: float
    width: int
    height: int

    @classmethod
    def over(cls, box: tuple[int, int, int, int], *, target_height: int = TARGET_HEIGHT) -> Lattice:
        """The lattice of the pixel box (x, y, width, height), about `target_height` nodes high, step ≥ 1."""
        x, y, width, height = box
        if width < 1 or height < 1 or target_height < 2:
            raise ValueError(f"a box of at least 1x1 pixels and 2 nodes is needed, got {box}, {target_height}")
        step = max(1.0, height / target_height)
        return cls(x, y, step, _nodes(width, step), _nodes(height, step))


def _nodes(pixels: int, step: float) -> int:
    return max(2, math.ceil((pixels - 1) / step - 1e-6) + 1)


@dataclass(frozen=True, eq=False)
class CurveRaster:
    """Where curves cut the edges of a lattice; it depends on positions only, so it serves any values.

    levels: (L, 5) int64, the grid hierarchy (see `_multigrid`), the lattice itself first.
    theta: (4, N) float32, distance in steps to the nearest cut to the right, left, below and above; inf if whole.
    node: (E,) int64, the node that tie e holds;  weight: (E,) float32, 1/θ, from 1 to 1000.
    start, stop: (E,) int32 samples of γ around the crossing;  place: (E,) float32, where between them.
    """

    lattice: Lattice
    samples: int
    levels: NDArray[np.int64]
    theta: Floats
    node: NDArray[np.intp]
    weight: Floats
    start: NDArray[np.int32]
    stop: NDArray[np.int32]
    place: Floats

    def values(self, samples: ArrayLike) -> Floats:
        """The values of γ at the E ties, linear between samples. samples: (S, C) -> (E, C) float32."""
        known = np.asarray(samples, dtype=np.float32)
        if known.ndim != 2 or len(known) != self.samples:
            raise ValueError(f"the curve values must have the shape ({self.samples}, C), got {known.shape}")
        return np.asarray(multigrid.tie_values(known, self.start, self.stop, self.place).T)


def rasterize_curves(
    points: ArrayLike, layout: Layout, lattice: Lattice, *, active: ArrayLike | None = None
) -> CurveRaster:
    """Cut the edges of `lattice` where the polylines γ cross them.

    points: (S, 2) source pixels (x, y), finite; they may leave the box.
    layout: (start, stop, closed) of each curve's run of samples.
    active: (S,) bool; an inactive sample takes its two segments out of γ. All are active when None.

    Where several curves cross one edge, each of its ends sees the nearest crossing. A curve that crosses no edge
    (shorter than the step) has no effect. Raises ValueError on input of the wrong shape or range.
    """
    placed = np.asarray(points, dtype=np.float64)
    if placed.ndim != 2 or placed.shape[1] != 2 or not np.isfinite(placed).all():
        raise ValueError(f"the curve points must be finite and of the shape (S, 2), got {placed.shape}")
    used = np.ones(len(placed), np.bool_) if active is None else np.asarray(active, dtype=np.bool_)
    if used.shape != (len(placed),):
        raise ValueError(f"active must have the shape ({len(placed)},), got {used.shape}")
    start, stop = _segments(tuple(layout), len(used))
    if not used.all():
        kept = used[start] & used[stop]
        start, stop = start[kept], stop[kept]
    levels = _levels(lattice.height, lattice.width)
    size = int(levels[-1, 0] + (levels[-1, 1] + 2) * (levels[-1, 2] + 2))
    scaled = (placed - (lattice.x, lattice.y)) / lattice.step
    theta, source, place = multigrid.cut_edges(scaled, start, stop, levels, size)
    cut = np.flatnonzero(theta.ravel() < np.inf)
    segment = source.ravel()[cut]
    weight = 1.0 / np.maximum(theta.ravel()[cut], MIN_THETA)
    return CurveRaster(
        lattice, len(placed), levels, theta, cut % size, weight, start[segment], stop[segment], place.ravel()[cut]
    )  # fmt: skip


@lru_cache(maxsize=4)
def _segments(layout: tuple[tuple[int, int, bool], ...], samples: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """First and last sample of every segment of γ."""
    start, stop = [np.empty(0, np.int32)], [np.empty(0, np.int32)]
    for first, last, closed in layout:
        if not 0 <= first <= last <= samples:
            raise ValueError(f"the curve ({first}, {last}) leaves the {samples} samples")
        run = np.arange(first, last, dtype=np.int32)
        start.append(run if closed else run[:-1])
        stop.append(np.roll(run, -1) if closed else run[1:])
    return np.concatenate(start), np.concatenate(stop)


@dataclass(frozen=True, eq=False)
class Membrane:
    """A solved membrane on its lattice. planes: (C, h, w) float32, in the units of the curve values."""

    lattice: Lattice
    planes: Floats

    def at(self, points: ArrayLike) -> Floats:
        """Values at source points (x, y), any position of the box. points: (N, 2) -> (N, C) float32."""
        places = (np.asarray(points, np.float64).reshape(-1, 2) - self._origin) / self.lattice.step
        limits = np.array([self.lattice.width - 1, self.lattice.height - 1])
        places = np.clip(places, 0.0, limits)
        corner = np.minimum(places.astype(np.intp), limits - 1)
        fx, fy = (places - corner).astype(np.float32).T
        x, y = corner.T
        upper = self.planes[:, y, x] + fx * (self.planes[:, y, x + 1] - self.planes[:, y, x])
        lower = self.planes[:, y + 1, x] + fx * (self.planes[:, y + 1, x + 1] - self.planes[:, y + 1, x])
        return np.ascontiguousarray((upper + fy * (lower - upper)).T)

    def read(self, xs: ArrayLike, ys: ArrayLike, channels: slice | Sequence[int] = slice(None)) -> Floats:
        """Values over the product of source coordinates: (C, len(ys), len(xs)) float32.

        xs, ys: any 1-D source coordinates; those outside the lattice repeat its border. For chroma planes at half
        size pass the chroma sites. A part reads the same numbers as the whole.
        """
        columns = (np.asarray(xs, np.float64) - self.lattice.x) / self.lattice.step
        rows = (np.asarray(ys, np.float64) - self.lattice.y) / self.lattice.step
        planes = self.planes[channels]
        out = np.empty((len(planes), len(rows), len(columns)), np.float32)
        for plane, to in zip(planes, out, strict=True):
            read_grid(plane, columns, rows, to)
        return out

    def crop(self, x: int, y: int, width: int, height: int) -> Floats:
        """The pixels [x, x + width) × [y, y + height) of the source: (height, width, C) float32."""
        read = self.read(np.arange(x, x + width), np.arange(y, y + height))
        return np.moveaxis(read, 0, -1)

    @property
    def _origin(self) -> tuple[float, float]:
        return self.lattice.x, self.lattice.y


@dataclass(frozen=True, eq=False)
class MembraneOperator:
    """The equations of one geometry with their grid hierarchy; made by `build_membrane`.

    weight: (E,) what each tie of the raster adds to the load of its node.
    parts: (N,) edges to the right and down, ties, diagonal and its reciprocal on all levels, see `_multigrid`.
    share: (4, N), how much of a block's correction its children take.
    """

    raster: CurveRaster
    weight: Floats
    parts: tuple[Floats, Floats, Floats, Floats, Floats]
    share: Floats

    def solve(self, values: ArrayLike, *, guess: Membrane | None = None, tolerance: ArrayLike = TOLERANCE) -> Membrane:
        """The harmonic extension of `values` from γ, zero outside the domain.

        values: (S, C) finite, the values at the samples of γ; C is any number of channels (3 a look).
        guess: a membrane of a like geometry and as many channels, for instance of the frame before, to start from.
        tolerance: estimated largest error, in the units of the values, for all channels or each of them; the true one
        was below it on faces and at most 10 times it on odd random domains. Raises SolverError when it is not met.
        """
        raster, lattice = self.raster, self.raster.lattice
        ties = raster.values(values).T
        low, high = ties.min(axis=1, initial=np.inf), ties.max(axis=1, initial=-np.inf)
        if not np.isfinite(high - low).all():
            raise SolverError("the curve values hold NaN or infinity; check the colours of the curves")
        middle = 0.5 * (low + high)  # makes constants exact
        wanted = np.broadcast_to(np.asarray(tolerance, np.float32), (len(ties),))
        if ((high - low) * FINEST > wanted).any():
            raise SolverError(f"a tolerance of {wanted.min():g} is finer than float32 resolves; take {TOLERANCE}")
        start = None if guess is None else self._start(guess, len(ties))
        planes = np.empty((len(ties), lattice.height, lattice.width), np.float32)
        held = self.inverse > 0.0
        inside, whole = self._finest(held), _ones(self.share.shape[1])
        for channel, plane in enumerate(planes):
            u, b = np.zeros_like(self.inverse), np.empty_like(self.inverse)
            multigrid.load(raster.node, self.weight, ties[channel], middle[channel], self.inverse, b)
            if start is not None:
                self._finest(u)[:] = start[channel] - middle[channel]
                u *= held
            solved, cycles, error = multigrid.solve(
                u, b, self.parts, self.share, whole, raster.levels, start is not None, wanted[channel], MAX_CYCLES
            )
            if not error <= wanted[channel]:
                raise SolverError(
                    f"the membrane of {lattice.width}x{lattice.height} nodes, channel {channel}, is off by about "
                    f"{error:.3g} levels after {cycles} cycles (wanted {wanted[channel]:g}); raise the tolerance"
                )
            np.multiply(self._finest(solved) + middle[channel], inside, out=plane)
        return Membrane(lattice, planes)

    @property
    def inverse(self) -> Floats:
        """(N,) the reciprocal diagonal on all levels, zero outside the domain."""
        return self.parts[4]

    def _finest(self, flat: NDArray[Any]) -> NDArray[Any]:
        """The (h, w) nodes of the lattice inside an array over all levels."""
        return _finest(flat, self.raster.levels)

    def _start(self, guess: Membrane, channels: int) -> Floats:
        if len(guess.planes) != channels:
            raise ValueError(f"the guess has {len(guess.planes)} channels, the values have {channels}")
        lattice = self.raster.lattice
        if guess.lattice == lattice:
            return guess.planes
        xs = lattice.x + lattice.step * np.arange(lattice.width)
        ys = lattice.y + lattice.step * np.arange(lattice.height)
        return guess.read(xs, ys)


def build_membrane(raster: CurveRaster, *, domain: ArrayLike | None = None) -> MembraneOperator:
    """Set up the equations on a lattice whose edges γ cuts; one operator serves every right-hand side.

    domain: (h, w) bool, nodes of Ω; the whole lattice when None.
    Raises SolverError when a 4-connected part of the domain touches no curve: it has no unique solution.
    """
    height, width = raster.lattice.height, raster.lattice.width
    inside = None if domain is None else np.asarray(domain, np.bool_)
    if inside is not None and inside.shape != (height, width):
        raise ValueError(f"the domain must have the shape ({height}, {width}), got {inside.shape}")
    full = np.ones((height, width), np.bool_) if inside is None else inside
    size = raster.theta.shape[1]
    parts, share = multigrid.assemble(raster.theta, full, raster.levels, MIN_THETA, size)
    _check_ties(_finest(parts[2], raster.levels), inside)
    # Coarser levels may hold a node more firmly than its own cuts do; its load follows.
    traced = np.bincount(raster.node, raster.weight, minlength=size)[raster.node]
    weight = (raster.weight * (parts[2][raster.node] / traced)).astype(np.float32)
    return MembraneOperator(raster, weight, parts, share)


@lru_cache(maxsize=4)
def _ones(size: int) -> Floats:
    """(4, size) ones, the shares of a start, whose blocks' children take all of it."""
    return np.ones((4, size), np.float32)


def _finest(flat: NDArray[Any], levels: NDArray[np.int64]) -> NDArray[Any]:
    _, h, w, rows, columns = levels[0]
    return flat[: (h + 2) * (w + 2)].reshape(h + 2, w + 2)[1 : rows + 1, 1 : columns + 1]


def _levels(height: int, width: int) -> NDArray[np.int64]:
    """(offset, h, w, rows, columns) of every level, halved until a side has at most 4 nodes; h and w are even."""
    levels, offset, rows, columns = [], 0, height, width
    while True:
        h, w = rows + rows % 2, columns + columns % 2
        levels.append((offset, h, w, rows, columns))
        offset += (h + 2) * (w + 2)
        if min(rows, columns) <= 4:
            return np.array(levels, np.int64)
        rows, columns = h // 2, w // 2


def _check_ties(ties: Floats, inside: NDArray[np.bool_] | None) -> None:
    """Every connected part must be tied to γ; a cut inside a part ties both of its sides."""
    if not ties.any():
        raise SolverError("no curve crosses the lattice of the face's box; check the curve points and the box")
    if inside is None:
        return
    count, labels = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)
    tied = np.bincount(labels.ravel(), ties.ravel(), minlength=count) > 0
    tied[0] = True
    if not tied.all():
        part = int(np.argmin(tied))
        rows, columns = np.nonzero(labels == part)
        raise SolverError(
            f"part {part} of the domain ({len(rows)} nodes, rows {rows.min()}-{rows.max()}, columns "
            f"{columns.min()}-{columns.max()}) touches no curve; every part needs one"
        )
