"""Diffusion curves: landmark curves and the mask boundary, as samples with a label (curve id, parameter s).

A landmark curve is a uniform Catmull-Rom spline through its landmarks; the parameter of every landmark is fixed
(knot k of K has s = k/(K-1), or k/K on a closed curve), so a position is a constant linear combination of
landmarks and the same label is the same place of the face in every frame. The mask boundary has no landmarks:
its parameter is the polar angle around the face's centre, measured from the face's own downward direction, so
its start cannot slide along the contour.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Floats
from pvg.face import Landmarks, layout

BOUNDARY_SAMPLES = 192

Knot = int | tuple[int, int, float]


def _on(points: layout.Indices) -> tuple[Knot, ...]:
    return tuple(points.tolist())


def _half_way(pairs: layout.Pairs) -> tuple[Knot, ...]:
    return tuple((i, j, 0.5) for i, j in pairs)


@dataclass(frozen=True)
class Curve:
    """One diffusion curve.

    knots: stacked points (see `pvg.face.layout`), or places (i, j, t) on the way from point i to point j; the mask
    boundary has none.  group: the part of the face whose colour it carries.  per_segment: samples between two knots.
    """

    name: str
    group: str
    closed: bool
    knots: tuple[Knot, ...]
    per_segment: int


CURVES: tuple[Curve, ...] = (
    Curve("jaw", "skin", False, _on(layout.CONTOUR), 2),
    Curve("ring", "skin", True, _on(layout.STACKED_RING), 3),
    Curve("cheek_left", "skin", True, _on(layout.STACKED_LEFT_CHEEK), 4),
    Curve("cheek_right", "skin", True, _on(layout.STACKED_RIGHT_CHEEK), 4),
    Curve("brow_left", "brows", True, _on(layout.LEFT_BROW), 2),
    Curve("brow_right", "brows", True, _on(layout.RIGHT_BROW), 2),
    Curve("eye_left", "eyes", True, _on(layout.LEFT_EYE), 2),
    Curve("eye_right", "eyes", True, _on(layout.RIGHT_EYE), 2),
    Curve("nose_bridge", "skin", False, _on(layout.NOSE_RIDGE), 4),
    Curve("nose_base", "skin", False, _on(layout.NOSE_BASE_TO_WINGS), 3),
    Curve("nose_left", "skin", False, _on(layout.LEFT_NOSE_SIDE), 5),
    Curve("nose_right", "skin", False, _on(layout.RIGHT_NOSE_SIDE), 5),
    Curve("lips_outer", "lips", True, _on(layout.LIPS_OUTER), 3),
    Curve("lips_inner", "lips", True, _on(layout.LIPS_INNER), 3),
    # open skin between the features: without curves there its colour would only be interpolated
    Curve("forehead", "skin", False, _on(layout.FOREHEAD), 3),
    Curve("upper_lip", "skin", False, _half_way(layout.UPPER_LIP_TO_NOSE), 3),
    Curve("chin", "skin", False, _half_way(layout.LOWER_LIP_TO_CHIN), 3),
    Curve("lower_cheek_left", "skin", False, _half_way(layout.LEFT_CHEEK_TO_JAW), 4),
    Curve("lower_cheek_right", "skin", False, _half_way(layout.RIGHT_CHEEK_TO_JAW), 4),
    Curve("boundary", "skin", True, (), BOUNDARY_SAMPLES),
)
BOUNDARY = len(CURVES) - 1
GROUPS = ("skin", "brows", "eyes", "lips")


@dataclass(frozen=True, eq=False)
class CurveLabels:
    """Labels of S samples, curve after curve in the order of `CURVES`.

    curve: (S,) int16, index into `CURVES`;  s: (S,) float32, parameter in [0, 1] (in [0, 1) on closed curves).
    """

    curve: NDArray[np.int16]
    s: Floats

    def __len__(self) -> int:
        return len(self.curve)

    @cached_property
    def spans(self) -> tuple[tuple[int, int, bool], ...]:
        """(start, stop, closed) of each curve's run of samples, in the order of `CURVES`."""
        starts = np.searchsorted(self.curve, np.arange(len(CURVES) + 1))
        return tuple((int(starts[c]), int(starts[c + 1]), CURVES[c].closed) for c in range(len(CURVES)))

    @cached_property
    def group(self) -> NDArray[np.int8]:
        """(S,) index into `GROUPS` of each sample."""
        of_curve = np.array([GROUPS.index(curve.group) for curve in CURVES], np.int8)
        return of_curve[self.curve]

    def on_curves(self, *names: str) -> Bools:
        """(S,) bool: samples on the curves of `CURVES` with these names. Raises ValueError for a name of none."""
        known = [curve.name for curve in CURVES]
        return np.isin(self.curve, [known.index(name) for name in names])

    def on_group(self, name: str) -> Bools:
        """(S,) bool: samples on the curves of a group of `GROUPS`. Raises ValueError for another name."""
        return np.asarray(self.group == GROUPS.index(name))

    @cached_property
    def on_open_skin(self) -> Bools:
        """(S,) bool: samples on curves of skin, the mask boundary left out."""
        return np.asarray(self.on_group("skin") & (self.curve != BOUNDARY))

    @cached_property
    def basis(self) -> Floats:
        """(S_l, 194) weights: positions of the S_l landmark-curve samples = basis @ stacked points."""
        landmark = self.curve != BOUNDARY
        basis = np.zeros((int(landmark.sum()), layout.LANDMARK_COUNT + layout.SKIN_COUNT), np.float32)
        for row, (c, s) in enumerate(zip(self.curve[landmark], self.s[landmark], strict=True)):
            _add_catmull_rom(basis[row], CURVES[c], float(s))
        return basis


def _add_catmull_rom(row: Floats, curve: Curve, s: float) -> None:
    """Add to `row` the weights of the uniform Catmull-Rom spline of `curve` at parameter `s`."""
    count = len(curve.knots)
    segments = count if curve.closed else count - 1
    k = min(int(s * segments + 1e-6), segments - 1)
    t = s * segments - k
    weights = (
        -0.5 * t + t**2 - 0.5 * t**3,
        1 - 2.5 * t**2 + 1.5 * t**3,
        0.5 * t + 2 * t**2 - 1.5 * t**3,
        -0.5 * t**2 + 0.5 * t**3,
    )
    for offset, weight in zip((-1, 0, 1, 2), weights, strict=True):
        j = k + offset
        if curve.closed:
            _add_knot(row, curve.knots[j % count], weight)
        elif 0 <= j < count:
            _add_knot(row, curve.knots[j], weight)
        else:  # an open end: the phantom knot is the mirror image 2 p_end - p_next
            end, inner = (0, 1) if j < 0 else (count - 1, count - 2)
            _add_knot(row, curve.knots[end], 2 * weight)
            _add_knot(row, curve.knots[inner], -weight)


def _add_knot(row: Floats, knot: Knot, weight: float) -> None:
    i, j, t = knot if isinstance(knot, tuple) else (knot, knot, 0.0)
    row[i] += (1.0 - t) * weight
    row[j] += t * weight


def _uniform(counts: tuple[int, ...]) -> CurveLabels:
    curve, s = [], []
    for c, n in enumerate(counts):
        curve.append(np.full(n, c, np.int16))
        s.append(np.arange(n) / (n if CURVES[c].closed else n - 1))
    return CurveLabels(np.concatenate(curve), np.concatenate(s).astype(np.float32))


@cache
def table_labels() -> CurveLabels:
    """The labels of the clip-wide table: the same for every clip, so a colour table needs no labels of its own."""
    counts = []
    for curve in CURVES:
        segments = len(curve.knots) if curve.closed else len(curve.knots) - 1
        counts.append(segments * curve.per_segment + (not curve.closed) if curve.knots else curve.per_segment)
    return _uniform(tuple(counts))


def labels_by_length(landmarks: Landmarks, boundary: Floats, *, spacing_px: float) -> CurveLabels:
    """Labels of one frame sampled by arc length, as the paper's frame-to-frame chain does (eq. 5).

    landmarks: of one picture;  boundary: (BOUNDARY_SAMPLES, 2) source pixels.  Each frame gets its own sample counts.
    """
    table = table_labels()
    positions = place(table, landmarks, boundary)
    counts = []
    for start, stop, closed in table.spans:
        run = positions[start:stop]
        steps = np.diff(run, axis=0, append=run[:1]) if closed else np.diff(run, axis=0)
        counts.append(max(4, round(float(np.hypot(steps[:, 0], steps[:, 1]).sum()) / spacing_px)))
    return _uniform(tuple(counts))


def place(labels: CurveLabels, landmarks: Landmarks, boundary: Floats) -> Floats:
    """Positions (S, 2) of the samples in one frame.

    landmarks: of one picture, source pixels;  boundary: (BOUNDARY_SAMPLES, 2) the mask boundary at equal steps of s.
    Samples of the boundary between those are interpolated linearly.
    """
    on_landmarks = labels.basis @ landmarks.stacked
    s = labels.s[labels.curve == BOUNDARY] * len(boundary)
    k = np.floor(s).astype(np.int64)
    t = (s - k)[:, None].astype(np.float32)
    n = len(boundary)
    on_boundary = (1 - t) * boundary[k % n] + t * boundary[(k + 1) % n]
    return np.concatenate([on_landmarks, on_boundary])
