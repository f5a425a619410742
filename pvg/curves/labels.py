"""Diffusion curves: landmark curves and the mask boundary, as samples with a label (curve id, parameter s).

A landmark curve is a uniform Catmull-Rom spline through its landmarks; the parameter of every landmark is fixed
(knot k of K has s = k/(K-1), or k/K on a closed curve), so a position is a constant linear combination of
landmarks and the same label is the same place of the face in every frame. The mask boundary has no landmarks:
its parameter is the polar angle about the face's centre, measured from the face's own downward direction, so
its start cannot slide along the contour.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from pvg.curves._rays import last_crossing
from pvg.face._kernels import frame_numbers

Floats = NDArray[np.float32]

JAW = tuple(range(33))
_SKIN0 = 106  # the 88 skin points follow the 106 landmarks in the stacked array
_OVAL = tuple(range(_SKIN0, _SKIN0 + 36))
_RING = tuple(range(_SKIN0 + 36, _SKIN0 + 72))
_CHEEK_LEFT = tuple(range(_SKIN0 + 72, _SKIN0 + 80))
_CHEEK_RIGHT = tuple(range(_SKIN0 + 80, _SKIN0 + 88))
BOUNDARY_SAMPLES = 192
_RAY_STEP = 0.5


Knot = int | tuple[int, int, float]


def _half_way(*pairs: tuple[int, int]) -> tuple[Knot, ...]:
    return tuple((i, j, 0.5) for i, j in pairs)


@dataclass(frozen=True)
class Curve:
    """One diffusion curve.

    `knots` index the stacked (106 landmarks, 88 skin points), or name a place (i, j, t) on the way from point i to
    point j; the mask boundary has none. `group` is the part of the face whose colour it carries. `per_segment` is the
    number of samples between two knots.
    """

    name: str
    group: str
    closed: bool
    knots: tuple[Knot, ...]
    per_segment: int


CURVES: tuple[Curve, ...] = (
    Curve("jaw", "skin", False, JAW, 2),
    Curve("ring", "skin", True, _RING, 3),
    Curve("cheek_left", "skin", True, _CHEEK_LEFT, 4),
    Curve("cheek_right", "skin", True, _CHEEK_RIGHT, 4),
    Curve("brow_left", "brows", True, (33, 34, 35, 36, 37, 67, 66, 65, 64), 2),
    Curve("brow_right", "brows", True, (38, 39, 40, 41, 42, 71, 70, 69, 68), 2),
    Curve("eye_left", "eyes", True, (52, 53, 72, 54, 55, 56, 73, 57), 2),
    Curve("eye_right", "eyes", True, (58, 59, 75, 60, 61, 62, 76, 63), 2),
    Curve("nose_bridge", "skin", False, (43, 44, 45, 46), 4),
    Curve("nose_base", "skin", False, (82, 47, 48, 49, 50, 51, 83), 3),
    Curve("nose_left", "skin", False, (78, 80, 82), 5),
    Curve("nose_right", "skin", False, (79, 81, 83), 5),
    Curve("lips_outer", "lips", True, tuple(range(84, 96)), 3),
    Curve("lips_inner", "lips", True, tuple(range(96, 104)), 3),
    # open skin between the features: without curves there its colour would only be interpolated
    Curve("forehead", "skin", False, (138, 139, 140, 141, 106, 107, 108, 109, 110), 3),
    Curve("upper_lip", "skin", False, _half_way((85, 47), (86, 48), (87, 49), (88, 50), (89, 51)), 3),
    Curve(
        "chin", "skin", False, _half_way((84, 166), (95, 164), (94, 162), (93, 160), (92, 158), (91, 156), (90, 154)), 3
    ),
    Curve("lower_cheek_left", "skin", False, _half_way((185, 168), (184, 167), (183, 166), (84, 183)), 4),
    Curve("lower_cheek_right", "skin", False, _half_way((193, 152), (192, 153), (191, 154), (90, 191)), 4),
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

    @cached_property
    def basis(self) -> Floats:
        """(S_l, 194) weights: positions of the S_l landmark-curve samples = basis @ stacked points."""
        landmark = self.curve != BOUNDARY
        basis = np.zeros((int(landmark.sum()), _SKIN0 + 88), np.float32)
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


def labels_by_length(points: Floats, boundary: Floats, *, spacing_px: float) -> CurveLabels:
    """Labels of one frame sampled by arc length, as the paper's frame-to-frame chain does (eq. 5).

    points: (194, 2) stacked landmarks;  boundary: (BOUNDARY_SAMPLES, 2).  Each frame gets its own sample counts.
    """
    table = table_labels()
    positions = place(table, points, boundary)
    counts = []
    for start, stop, closed in table.spans:
        run = positions[start:stop]
        steps = np.diff(run, axis=0, append=run[:1]) if closed else np.diff(run, axis=0)
        counts.append(max(4, round(float(np.hypot(steps[:, 0], steps[:, 1]).sum()) / spacing_px)))
    return _uniform(tuple(counts))


def place(labels: CurveLabels, points: Floats, boundary: Floats) -> Floats:
    """Positions (S, 2) of the samples in one frame.

    points: (194, 2) stacked landmarks and skin points, source pixels;  boundary: (BOUNDARY_SAMPLES, 2) the mask
    boundary at equal steps of s. Samples of the boundary between those are interpolated linearly.
    """
    on_landmarks = labels.basis @ points
    s = labels.s[labels.curve == BOUNDARY] * len(boundary)
    k = np.floor(s).astype(np.int64)
    t = (s - k)[:, None].astype(np.float32)
    n = len(boundary)
    on_boundary = (1 - t) * boundary[k % n] + t * boundary[(k + 1) % n]
    return np.concatenate([on_landmarks, on_boundary])


def stack_points(points: Floats, skin_points: Floats) -> Floats:
    """Stack (…, 106, 2) landmarks and (…, 88, 2) skin points into (…, 194, 2)."""
    return np.concatenate([points, skin_points], axis=-2)


@dataclass(frozen=True)
class FaceFrame:
    """The face's own coordinate frame in a picture: origin between mouth and nose, y towards the chin.

    center: (2,) source pixels;  down: (2,) unit vector towards the chin;  width: jaw width in pixels.
    """

    center: Floats
    down: Floats
    width: float


def face_frame(points: Floats) -> FaceFrame:
    """The face frame of (106, 2) landmarks.

    The direction comes from the line between the eye contours' centres, which speech and smiles do not move.
    """
    x, y, down_x, down_y, width = frame_numbers(np.asarray(points, np.float64))
    return FaceFrame(np.array([x, y], np.float32), np.array([down_x, down_y], np.float32), width)


def _rays(frame: FaceFrame) -> Floats:
    """(BOUNDARY_SAMPLES, 2) unit vectors at equal angles, the first towards the chin."""
    angle = np.arange(BOUNDARY_SAMPLES) * (2 * np.pi / BOUNDARY_SAMPLES)
    side = np.array([frame.down[1], -frame.down[0]])
    rays: Floats = (np.cos(angle)[:, None] * frame.down + np.sin(angle)[:, None] * side).astype(np.float32)
    return rays


def boundary_radius(matte: Floats, points: Floats) -> Floats:
    """Distance of the skin's outer boundary, where the matte falls through 1/2, from the face's centre.

    matte: (H, W) float32 in [0, 1];  points: (106, 2) landmarks in the matte's pixels.
    Returns (BOUNDARY_SAMPLES,) float32 pixels at equal angles, 0 where a ray meets no skin. Along a ray the last
    crossing counts, so a fold of the contour (an ear, the jaw above the neck) is crossed straight and never traced
    twice; between steps it is interpolated, so the boundary moves smoothly as the matte does.
    """
    frame = face_frame(points)
    x, y = (np.float32(v) for v in frame.center)
    count = int(np.ceil(float(np.hypot(*matte.shape)) / _RAY_STEP))
    radius = np.empty(BOUNDARY_SAMPLES, np.float32)
    last_crossing(np.ascontiguousarray(matte, np.float32), x, y, _rays(frame), np.float32(_RAY_STEP), count, radius)
    return radius


def boundary_points(radius: Floats, points: Floats) -> Floats:
    """Positions (BOUNDARY_SAMPLES, 2) of the boundary samples at `radius` from the centre of (106, 2) landmarks."""
    frame = face_frame(points)
    return frame.center + _rays(frame) * radius[:, None]
