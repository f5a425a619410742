"""Where skin can be: a face's own frame, its box, and how likely each place is skin before colour is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.face import FaceAxes, Landmarks, layout
from pvg.skin._kernels import place_fields

_SHIFT = 4  # polygons are rasterised with 1/16 px
_BEARD_REACH = 0.25  # face sizes outside the contour
_NECK_END = 1.12  # face sizes below the chin: the box's end
_NECK_FADE = 0.75  # from here to the box's end the matte fades, for a bare chest goes on beyond
_FEATURE_MARGIN = 0.03  # of the face's size: lashes, brow hairs and lip contours spill over


def logistic(odds: Floats) -> Floats:
    """Probability of log-odds."""
    probability: Floats = (1 / (1 + np.exp(-odds))).astype(np.float32)
    return probability


@dataclass(frozen=True, eq=False)
class HeadShape:
    """What of a head is measured along the face's axes; lengths in the picture's pixels.

    axes: the face's;  middle: (2,) of the oval;  width, height: extents of the oval along the axes;
    chin: (2,) the oval's end on the axis;  neck: (2,) unit vector along which the neck runs, between the face's
    downward direction and the picture's.
    """

    axes: FaceAxes
    middle: Floats
    width: float
    height: float
    chin: Floats
    neck: Floats

    @property
    def size(self) -> float:
        """A length that a turn of the head changes little: the geometric mean of width and 0.8 height."""
        return max(1.0, float(np.sqrt(self.width * 0.8 * self.height)))

    def depth(self, points: Floats) -> float:
        """Mean position of points (n, 2) towards the chin, in sizes from the middle."""
        return float((points.mean(axis=0) - self.middle) @ self.axes.down) / self.size


def head_shape(landmarks: Landmarks) -> HeadShape:
    """The shape of a head from its landmarks."""
    axes = landmarks.axes
    points = landmarks.points
    eyes = points[58:64].mean(axis=0) - points[52:58].mean(axis=0)
    across = (eyes / max(float(np.hypot(*eyes)), 1e-6)).astype(np.float32)
    down = np.array([-across[1], across[0]], np.float32)
    axes = FaceAxes(axes.center, down, across, axes.width)
    oval = landmarks.oval
    a, d = oval @ across, oval @ down
    center = (a.min() + a.max()) / 2 * across + (d.min() + d.max()) / 2 * down
    height = float(np.ptp(d))
    neck = down + np.array([0, 1], np.float32)
    length = float(np.hypot(*neck))
    neck = neck / length if length > 0.2 else down  # a head upside down: there is no direction between
    return HeadShape(
        axes=axes,
        middle=center.astype(np.float32),
        width=float(np.ptp(a)),
        height=height,
        chin=(center + height / 2 * down).astype(np.float32),
        neck=neck.astype(np.float32),
    )


def face_box(landmarks: Landmarks) -> Floats:
    """The region of a face: hair-line, ears and neck down to a collar, in an upright box.

    Returns (4,) float32 x0, y0, x1, y1, source pixels; it moves smoothly with the points and may reach over the
    picture's edge.
    """
    head = head_shape(landmarks)
    # an ellipse around the head, and the neck's end; both in the face's frame so that a rolled face is covered
    half = (head.width / 2 + 0.22 * head.size, head.height / 2 + 0.26 * head.size)
    reach = np.hypot(half[0] * head.axes.across, half[1] * head.axes.down)
    side = np.array([head.neck[1], -head.neck[0]], np.float32) * (0.72 * head.size)
    end = head.chin + _NECK_END * head.size * head.neck
    corners = np.stack([head.middle - reach, head.middle + reach, end - side, end + side])
    return np.concatenate([corners.min(axis=0), corners.max(axis=0)]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Gap:
    """Something that is not skin-coloured but has skin at both ends: brows, a beard, the shadow under a chin.

    across: (2,) the longest such run, cells;  within: (h, w) bool, where it may be.
    """

    across: Floats
    within: Bools


@dataclass(frozen=True, eq=False)
class Places:
    """A face's places over a raster (h, w).

    prior: float32 log-odds of skin before any colour is looked at;  neckness: float32, 1 on the neck, 0 on the head;
    fade: float32, 1, falling to 0 where the box's end cuts a bare chest;
    outside: float32 distance from the face contour in face sizes, 0 within;
    face: the inside of the contour;  sure: skin or a feature of the face whatever its colour;
    sample: the part of `sure` that shows the skin's colour;  cheeks: that of `sample` below glasses;
    chin: that of `sure` below the lips;  jaw: about the face's lower end, where a beard can be;
    features: brows, eyes and lips, grown;  ears: where ears can be;  upper: all above the brows' middle line;
    brows: about the brows;
    above: a kernel (k, k) uint8 that reaches from a brow's cell to the forehead;
    gaps: what to close;  size: the face's size in cells.
    """

    prior: Floats
    neckness: Floats
    fade: Floats
    outside: Floats
    face: Bools
    sure: Bools
    sample: Bools
    cheeks: Bools
    chin: Bools
    jaw: Bools
    features: Bools
    ears: Bools
    upper: Bools
    brows: Bools
    above: Bytes
    gaps: tuple[Gap, ...]
    size: float


def _contour(landmarks: Landmarks) -> Floats:
    """Outline (n, 2) of the face as it is seen."""
    # beyond about 45° of yaw the contour's far side lies behind the visible cheek and nose: their hull is the face
    return _hull(np.concatenate([landmarks.oval, landmarks.points]))


def face_area(shape: tuple[int, int], landmarks: Landmarks) -> Bools:
    """(h, w) bool, the inside of the face contour, for landmarks in raster cells."""
    return _fill(shape, _contour(landmarks))


def locate(shape: tuple[int, int], landmarks: Landmarks) -> Places:
    """The places of a face over a raster (h, w), for landmarks in raster cells."""
    g, points = head_shape(landmarks), landmarks.points
    contour = _contour(landmarks)
    face = _fill(shape, contour)
    inner, outer = _distance(face), _distance(~face)
    brow = g.depth(points[layout.UPPER_BROW_EDGES])
    nose, mouth = g.depth(points[layout.NOSE_WINGS]), g.depth(points[layout.LIPS_OUTER])

    level = (g.depth(points[layout.EYE_CONTOURS]) + nose) / 2 + 0.04
    frame = np.concatenate([g.middle, g.axes.across, g.axes.down, g.chin, g.neck, [g.size, g.width]]).astype(np.float32)
    prior, neckness, fade, down, along, off, ears = np.empty((7, *shape), np.float32)
    ends = np.array([_NECK_FADE, _NECK_END], np.float32)
    depths = np.float32(brow), np.float32(level)
    place_fields(inner, outer, frame, *depths, ends, prior, neckness, fade, down, along, off, ears)
    outside = outer / np.float32(g.size)

    core = _fill(shape, contour.mean(axis=0) + 0.86 * (contour - contour.mean(axis=0)))
    sure = core & (down > brow + 0.05)
    features = _spread(shape, points, layout.FEATURES, _FEATURE_MARGIN * g.size)
    sample = sure & (down < mouth - 0.03) & ~features
    brows = _spread(shape, points, (layout.LEFT_BROW, layout.RIGHT_BROW), _FEATURE_MARGIN * g.size)
    return Places(
        prior=prior,
        neckness=neckness,
        fade=fade,
        outside=outside,
        face=face,
        sure=sure,
        sample=sample,
        cheeks=sample & (down > g.depth(points[layout.EYE_CONTOURS]) + 0.15),
        chin=sure & (down > max(g.depth(points[[i]]) for i in layout.LOWER_LIP_EDGE) + 0.03),
        jaw=(down > mouth) & (outside < _BEARD_REACH),
        features=features,
        ears=ears > -3,
        upper=down < brow,
        brows=brows,
        above=_upward(0.14 * g.size * g.axes.down),
        gaps=(
            Gap(0.30 * g.size * g.neck, (along > -0.3) & (along < 0.5) & (off < 0.2)),
            Gap(0.12 * g.size * g.neck, (along > -0.3) & (along < 0.4) & (off < 0.4)),
            Gap(0.16 * g.size * g.axes.down, brows),
        ),
        size=g.size,
    )


def _upward(step: Floats) -> Bytes:
    """A kernel of ones from its centre as far as the vector `step` (2,) is long, against it."""
    half = int(np.ceil(np.abs(step).max())) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.uint8)
    end = np.rint(half - step).astype(int)
    cv2.line(kernel, (half, half), (int(end[0]), int(end[1])), (1,), 1)
    return kernel


def _spread(shape: tuple[int, int], points: Floats, groups: tuple[layout.Indices, ...], margin: float) -> Bools:
    """(h, w) bool: the hulls of groups of landmarks, grown by a margin in cells."""
    out = np.zeros(shape, np.uint8)
    for indices in groups:
        out |= _fill(shape, _hull(points[indices])).astype(np.uint8)
    radius = max(1, round(margin))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return cv2.dilate(out, kernel).astype(np.bool_)


def _distance(mask: Bools) -> Floats:
    """(h, w) float32 distance of every cell of `mask` to the next cell outside it."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _fill(shape: tuple[int, int], polygon: Floats) -> Bools:
    """(h, w) bool, true inside a polygon (n, 2)."""
    out = np.zeros(shape, np.uint8)
    fixed = np.rint(np.clip(polygon, -8192, 8192) * (1 << _SHIFT)).astype(np.int32)
    cv2.fillPoly(out, [fixed], (1,), lineType=cv2.LINE_8, shift=_SHIFT)
    return out.astype(np.bool_)


def _hull(points: Floats) -> Floats:
    """Convex hull (n, 2) of points."""
    corners: Floats = cv2.convexHull(np.ascontiguousarray(points, np.float32))[:, 0].astype(np.float32)
    return corners
