"""Where the diffusion curves γ cut the edges of the lattice: the Dirichlet data of eq. (1) at their true positions.

Nodes are not blackened: every lattice edge that γ crosses is cut at the crossing, and each of its ends is later tied
to the value of γ there at its true distance θ. The two sides of a curve are thereby separated exactly, and the
positions of the curves are not rounded. γ is traced anew on every level of the grid hierarchy, so each is a true
discretisation with cut edges and not an average of the finer one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pvg._arrays import Doubles, Floats, Ints
from pvg._compiled import kernel
from pvg.membrane.lattice import Lattice, flat_size, grid_levels
from pvg.raster import on_copy

Layout = Sequence[tuple[int, int, bool]]
SampleIndices = NDArray[np.int32]

MIN_THETA = np.float32(0.001)
"""A node on a curve is tied by 1/θ = 1000 at most. [derived: what leaks through it to the other side of the curve is
below a thousandth]"""


@dataclass(frozen=True, eq=False)
class EdgeCuts:
    """Where curves cut the edges of a lattice; it depends on positions only, so it serves any values.

    A tie is one end of a cut edge of a level of the lattice: a node and the point of γ that holds it. E is the number
    of ties, N that of the numbers in an array over all levels.

    Attributes:
        lattice: the nodes.
        samples: S, the number of samples of γ.
        levels: (L, 5) int64, the grid hierarchy of `grid_levels`, the lattice itself first.
        theta: (4, N) float32, steps to the nearest cut to the right, left, below and above; inf where an edge is whole.
        node: (E,) int64, the node that a tie holds, as an index into arrays over all levels.
        weight: (E,) float32, 1/θ of a tie, from 1 to 1000.
        start, stop: (E,) int32, samples of γ on either side of the crossing.
        place: (E,) float32, where between them it lies, from 0 to 1.
    """

    lattice: Lattice
    samples: int
    levels: Ints
    theta: Floats
    node: NDArray[np.intp]
    weight: Floats
    start: SampleIndices
    stop: SampleIndices
    place: Floats

    def values(self, samples: ArrayLike) -> Floats:
        """The values of γ at the ties, linear between samples.

        Args:
            samples: (S, C), one row a sample of γ, in any unit.

        Returns:
            (E, C) float32.

        Raises:
            ValueError: another number of samples.
        """
        known = np.asarray(samples, dtype=np.float32)
        if known.ndim != 2 or len(known) != self.samples:
            raise ValueError(f"the curve values must have the shape ({self.samples}, C), got {known.shape}")
        return np.asarray(_tie_values(known, self.start, self.stop, self.place).T)


def cut_edges(points: ArrayLike, layout: Layout, lattice: Lattice, *, active: ArrayLike | None = None) -> EdgeCuts:
    """Cut the edges of `lattice` where the polylines γ cross them.

    Where several curves cross one edge, each of its ends sees the nearest crossing. A curve that crosses no edge
    (shorter than the step) has no effect.

    Args:
        points: (S, 2) source pixels (x, y), finite; they may leave the box.
        layout: (start, stop, closed) of each curve's run of samples.
        lattice: the nodes.
        active: (S,) bool; an inactive sample takes its two segments out of γ. All are active when None.

    Raises:
        ValueError: points or `active` of the wrong shape, points that are not finite, a run that leaves the samples.
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
    levels = grid_levels(lattice)
    size = flat_size(levels)
    scaled = (placed - (lattice.x, lattice.y)) / lattice.step
    theta, segments, places = _nearest_crossings(scaled, start, stop, levels, size)
    cut = np.flatnonzero(theta.ravel() < np.inf)
    segment = segments.ravel()[cut]
    weight = np.asarray(1.0 / np.maximum(theta.ravel()[cut], MIN_THETA), np.float32)
    return EdgeCuts(
        lattice, len(placed), levels, theta, cut % size, weight, start[segment], stop[segment], places.ravel()[cut]
    )


@lru_cache(maxsize=4)
def _segments(layout: tuple[tuple[int, int, bool], ...], samples: int) -> tuple[SampleIndices, SampleIndices]:
    """First and last sample of every segment of γ."""
    start, stop = [np.empty(0, np.int32)], [np.empty(0, np.int32)]
    for first, last, closed in layout:
        if not 0 <= first <= last <= samples:
            raise ValueError(f"the curve ({first}, {last}) leaves the {samples} samples")
        run = np.arange(first, last, dtype=np.int32)
        start.append(run if closed else run[:-1])
        stop.append(np.roll(run, -1) if closed else run[1:])
    return np.concatenate(start), np.concatenate(stop)


@kernel()
def _nearest_crossings(
    points: Doubles, start: SampleIndices, stop: SampleIndices, levels: Ints, size: int
) -> tuple[Floats, SampleIndices, Floats]:
    """Nearest crossing of γ on each of a node's four edges (right, left, below, above), on every level.

    points: (S, 2) in steps of the finest level;  start, stop: first and last sample of each segment.
    Returns theta (4, size) float32 distance in steps of the level, inf where the edge is whole; segments (4, size)
    int32; places (4, size) float32 along the segment. Crossings use half-open intervals, so a polyline through a node
    or along a row of nodes still separates its two sides.
    """
    theta = np.full((4, size), np.inf, np.float32)
    segments = np.zeros((4, size), np.int32)
    places = np.zeros((4, size), np.float32)
    scale = 1.0
    for level in range(len(levels)):
        offset, _, w, rows, columns = levels[level]
        for segment in range(len(start)):
            begin, end = points[start[segment]], points[stop[segment]]
            x0, y0 = on_copy(begin[0], scale), on_copy(begin[1], scale)
            x1, y1 = on_copy(end[0], scale), on_copy(end[1], scale)
            for axis in range(2):  # rows of nodes, then columns
                if axis == 0:
                    a0, b0, a1, b1, lines, nodes = x0, y0, x1, y1, rows, columns
                    stride, across = 1, w + 2
                else:
                    a0, b0, a1, b1, lines, nodes = y0, x0, y1, x1, columns, rows
                    stride, across = w + 2, 1
                first = max(0, int(np.ceil(min(max(min(b0, b1), -1.0), lines))))
                last = min(lines - 1, int(np.ceil(min(max(b0, b1, -1.0), lines))) - 1)
                for line in range(first, last + 1):
                    along = (line - b0) / (b1 - b0)
                    crossing = a0 + along * (a1 - a0)
                    if crossing < 0.0 or crossing > nodes - 1 or nodes < 2:
                        continue
                    node = min(int(crossing), nodes - 2)
                    index = offset + w + 3 + line * across + node * stride
                    for side in range(2):
                        distance = np.float32(crossing - node if side == 0 else node + 1 - crossing)
                        at = index + side * stride
                        if distance < theta[2 * axis + side, at]:
                            theta[2 * axis + side, at] = distance
                            segments[2 * axis + side, at] = segment
                            places[2 * axis + side, at] = along
        scale *= 0.5
    return theta, segments, places


@kernel()
def _tie_values(samples: Floats, start: SampleIndices, stop: SampleIndices, place: Floats) -> Floats:
    """(C, E) values at the ties, linear between the samples (S, C) float32 they lie between."""
    out = np.empty((samples.shape[1], len(start)), np.float32)
    for e in range(len(start)):
        for c in range(samples.shape[1]):
            first = samples[start[e], c]
            out[c, e] = first + place[e] * (samples[stop[e], c] - first)
    return out
