"""The spatial prior: a face's box, and how likely each place is skin before colour is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Floats, ramp
from pvg.face import FaceAxes, Landmarks, layout
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.skin._spatial_kernels import SpatialCoefficients, SpatialFields, spatial_fields
from pvg.skin.parameters import SKIN_PRIOR, Range, SkinPrior

_BOX, _REGIONS = SKIN_PRIOR.box, SKIN_PRIOR.regions


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
        """A length that a turn of the head changes little: see `pvg.skin.parameters`."""
        return max(1.0, float(np.sqrt(self.width * _BOX.size_height * self.height)))

    def places(self, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
        """Where cells (h, w) of the head's picture lie, in sizes from its middle: across it and towards the chin."""
        y, x = (along.astype(np.float32) for along in np.ogrid[: shape[0], : shape[1]])
        across, down = self.axes.across, self.axes.down
        off_x, off_y = (x - self.middle[0]) / np.float32(self.size), (y - self.middle[1]) / np.float32(self.size)
        return off_x * across[0] + off_y * across[1], off_x * down[0] + off_y * down[1]

    def of_oval(self, shape: tuple[int, ...]) -> Floats:
        """How far cells (h, w) of the head's picture are from its middle: 1 on the ellipse of the face's oval."""
        side, depth = self.places(shape)
        return np.asarray(2 * self.size * np.hypot(side / self.width, depth / self.height), np.float32)

    def depth(self, points: Floats) -> float:
        """Mean position of points (n, 2) towards the chin, in sizes from the middle."""
        return float((points.mean(axis=0) - self.middle) @ self.axes.down) / self.size


def head_shape(landmarks: Landmarks) -> HeadShape:
    """The shape of a head from its landmarks."""
    axes, oval = landmarks.axes, landmarks.oval
    across, down = axes.across, axes.down
    a, d = oval @ across, oval @ down
    (left, right), (top, bottom) = (a.min(), a.max()), (d.min(), d.max())
    center = (left + right) / 2 * across + (top + bottom) / 2 * down
    height = float(bottom - top)
    neck = down + np.array([0, 1], np.float32)
    length = float(np.hypot(*neck))
    neck = neck / length if length > _BOX.least_upright else down  # a head upside down: there is no direction between
    return HeadShape(
        axes=axes,
        middle=center.astype(np.float32),
        width=float(right - left),
        height=height,
        chin=(center + height / 2 * down).astype(np.float32),
        neck=neck.astype(np.float32),
    )


def ear_depth(head: HeadShape, landmarks: Landmarks) -> float:
    """Where the ears are, in sizes from the head's middle towards the chin."""
    eyes, nose = (head.depth(landmarks.points[part]) for part in (layout.EYE_CONTOURS, layout.NOSE_WINGS))
    return (eyes + nose) / 2 + SKIN_PRIOR.ears.below


def face_box(landmarks: Landmarks, *, bald: bool = False) -> Floats:
    """The region of a face: hair-line, ears and neck down to a collar, in an upright box.

    bald: up to the crown.
    Returns (4,) float32 x0, y0, x1, y1, source pixels; it moves smoothly with the points and may reach over the
    picture's edge.
    """
    head = head_shape(landmarks)
    # an ellipse around the head, and the neck's end; both in the face's frame so that a rolled face is covered
    half = (head.width / 2 + _BOX.beside * head.size, head.height / 2 + _BOX.above * head.size)
    reach = np.hypot(half[0] * head.axes.across, half[1] * head.axes.down)
    side = np.array([head.neck[1], -head.neck[0]], np.float32) * (_BOX.neck_half_width * head.size)
    end = head.chin + _BOX.neck_end * head.size * head.neck
    corners = np.stack([head.middle - reach, head.middle + reach, end - side, end + side])
    if bald:
        crown = head.middle - (head.height / 2 + _BOX.crown * head.size) * head.axes.down
        corners = np.concatenate([corners, crown[None]])
    return np.concatenate([corners.min(axis=0), corners.max(axis=0)]).astype(np.float32)


def logistic(log_odds: Floats) -> Floats:
    """Probability, in [0, 1], of log-odds (…), nats."""
    probability: Floats = (1 / (1 + np.exp(-log_odds))).astype(np.float32)
    return probability


@dataclass(frozen=True, eq=False)
class Closing:
    """Something that is not skin-coloured but has skin at both ends: a beard, the shadow under a chin.

    step: (2,) the longest such run, cells;  within: (h, w) bool, where it may be closed.
    """

    step: Floats
    within: Bools


@dataclass(frozen=True, eq=False)
class SpatialPrior:
    """What a face's landmarks say of the cells of a raster (h, w) before any colour is looked at.

    log_odds: float32, prior log-odds of skin;  neck: float32 weight in [0, 1], 1 on the neck, 0 on the head;
    fade: float32 in [0, 1], 1, falling to 0 where the box ends and at the sides of a bare chest;
    outside: float32 distance from the face contour in face sizes, 0 inside;
    face: bool, as all that follow, the inside of the contour;
    foreground: skin or a feature of the face whatever its colour, see `pvg.skin.network.certain`;
    sample: the part of `foreground` that shows the skin's colour;  cheeks: that of `sample` below glasses;
    features: brows, eyes and lips, grown;  ears: where ears can be;  forehead: all above the brows' middle line;
    along, off: float32, face sizes from the chin along the neck, and off its axis;
    closing: what to close in a mask;  size: the face size in cells.
    """

    log_odds: Floats
    neck: Floats
    fade: Floats
    outside: Floats
    face: Bools
    foreground: Bools
    sample: Bools
    cheeks: Bools
    features: Bools
    ears: Bools
    forehead: Bools
    along: Floats
    off: Floats
    closing: Closing
    size: float


def goes_on_above(mask: Bools, landmarks: Landmarks) -> bool:
    """Whether the skin of a mask (h, w) over a face's box goes on above it: the head is bald.

    landmarks: in cells.
    """
    return int(mask[:2].any(axis=0).sum()) > _BOX.cut * head_shape(landmarks).width


@dataclass(frozen=True, eq=False)
class _Outline:
    """The face as it is seen: what lies in the hull of its points, and in that of one of its slices.

    hull: (n, 2);  slices: (m, 2) each, see `layout.SLICES`.
    """

    hull: Floats
    slices: tuple[Floats, ...]

    @classmethod
    def of(cls, landmarks: Landmarks) -> _Outline:
        """Of landmarks in cells."""
        # beyond about 45° of yaw the contour's far side lies behind the visible cheek and nose: their hull is the face,
        # but for the hollows of a profile, which are between the slices
        hull = _hull(np.concatenate([landmarks.oval, landmarks.points]))
        return cls(hull, tuple(_hull(landmarks.stacked[part]) for part in layout.SLICES))

    def shrunk(self, share: float) -> _Outline:
        """The outline that is `share` as large around its middle."""
        middle = self.hull.mean(axis=0)
        hull, *slices = (middle + share * (part - middle) for part in (self.hull, *self.slices))
        return _Outline(hull, tuple(slices))

    def filled(self, shape: tuple[int, int]) -> Bools:
        """(h, w) bool, its inside."""
        within = np.zeros(shape, np.bool_)
        for part in self.slices:
            within |= _fill(shape, part)
        return within & _fill(shape, self.hull)


def face_area(shape: tuple[int, int], landmarks: Landmarks) -> Bools:
    """(h, w) bool, the inside of the face contour, for landmarks in raster cells."""
    return _Outline.of(landmarks).filled(shape)


def spatial_prior(shape: tuple[int, int], landmarks: Landmarks, *, bald: bool = False) -> SpatialPrior:
    """The prior of a face over a raster (h, w), for landmarks in raster cells.

    bald: whether skin may go on up to the crown.
    """
    head, points = head_shape(landmarks), landmarks.points
    outline = _Outline.of(landmarks)
    face = outline.filled(shape)
    inner, outer = _distance(face), _distance(~face)
    brow, eyes = head.depth(points[layout.UPPER_BROW_EDGES]), head.depth(points[layout.EYE_CONTOURS])
    mouth = head.depth(points[layout.LIPS_OUTER])
    ear = ear_depth(head, landmarks)
    vectors = (head.middle, head.axes.across, head.axes.down, head.chin, head.neck, [head.size, head.width])
    frame = np.concatenate(vectors).astype(np.float32)
    fields = SpatialFields(*np.empty((7, *shape), np.float32))
    fade_ends = np.array([_BOX.fade_begins, _BOX.neck_end, _BOX.side_fade], np.float32)
    spatial_fields(inner, outer, frame, np.float32(brow), np.float32(ear), fade_ends, _COEFFICIENTS, fields)
    log_odds, down, along, off = fields.log_odds, fields.down, fields.along, fields.off
    outside = outer / np.float32(head.size)
    if bald:
        log_odds = log_odds + _released(head, outside, down < brow)

    core = outline.shrunk(_REGIONS.core).filled(shape)
    foreground = core & (down > brow + _REGIONS.below_brows)
    features = _grown_hulls(shape, points, layout.FEATURES, _REGIONS.feature_margin * head.size)
    sample = foreground & (down < mouth - _REGIONS.above_lips) & ~features

    low, high = _REGIONS.beard_along
    around_beard = (along > low) & (along < high) & (off < _REGIONS.beard_off)
    return SpatialPrior(
        log_odds=log_odds,
        neck=fields.neck,
        fade=fields.fade,
        outside=outside,
        face=face,
        foreground=foreground,
        sample=sample,
        cheeks=sample & (down > eyes + _REGIONS.below_eyes),
        features=features,
        ears=fields.ears > SKIN_PRIOR.ears.least,
        forehead=down < brow,
        along=along,
        off=off,
        closing=Closing(_REGIONS.beard_length * head.size * head.neck, around_beard),
        size=head.size,
    )


def _released(head: HeadShape, outside: Floats, forehead: Bools) -> Floats:
    """(h, w) nats by which a bald head's crown is likelier skin than hair: above the forehead, not at the temples.

    outside: (h, w) face sizes from the contour;  forehead: (h, w) bool, what is above the brows.
    """
    numbers = SKIN_PRIOR.head
    ys, xs = np.mgrid[: outside.shape[0], : outside.shape[1]]
    beside = np.abs((xs - head.middle[0]) * head.axes.across[0] + (ys - head.middle[1]) * head.axes.across[1])
    narrow, wide = numbers.crown_beside
    middle = ramp(beside / head.width, wide, narrow)
    release = (numbers.forehead_outside - numbers.crown_outside) * outside * middle * forehead
    return np.asarray(release, np.float32)


def _line(ends: Range) -> tuple[np.float32, np.float32]:
    """Slope of the line that is 0 at the first end and 1 at the second, and its value at 0."""
    low, high = np.float32(ends[0]), np.float32(ends[1])
    slope = np.float32(1) / (high - low)
    return slope, -low * slope


def _coefficients(prior: SkinPrior) -> SpatialCoefficients:
    """The numbers of the spatial prior in the form computed with."""
    head, ears, neck, regions, one = prior.head, prior.ears, prior.neck, prior.regions, np.float32(1)
    head_slope, head_at_chin = _line(neck.head_rise)
    weight_slope, weight_at_chin = _line(neck.weight_rise)
    across = one / np.float32(ears.width)
    return SpatialCoefficients(
        cheek_inside=np.float32(head.cheek_inside),
        cheek_most=np.float32(head.cheek_most),
        cheek_outside=np.float32(head.cheek_outside),
        forehead_edge=np.float32(head.forehead_edge),
        forehead_inside=np.float32(head.forehead_inside),
        forehead_most=np.float32(head.forehead_most),
        forehead_outside=np.float32(head.forehead_outside),
        forehead_begins=np.float32(head.forehead_begins),
        forehead_full=np.float32(head.forehead_full),
        ear_across=across,
        ear_center=np.float32(ears.beside) * across,
        ear_along=one / np.float32(ears.height),
        ear_odds=np.float32(ears.odds),
        ear_floor=np.float32(ears.floor),
        ear_reach=np.float32(ears.reach),
        ear_none=np.float32(ears.none),
        neck_begins=np.float32(neck.begins),
        neck_none=np.float32(neck.none),
        neck_reach=np.float32(neck.reach),
        neck_half_width=np.float32(neck.half_width),
        neck_widening=np.float32(neck.widening),
        neck_edge=np.float32(neck.edge),
        neck_axis=np.float32(neck.axis),
        neck_fall=np.float32(neck.fall),
        neck_head=np.float32(neck.head),
        neck_head_slope=head_slope,
        neck_head_at_chin=head_at_chin,
        neck_weight_slope=weight_slope,
        neck_weight_at_chin=weight_at_chin,
        chest_begins=np.float32(neck.chest_rise[0]),
        chest_full=np.float32(neck.chest_rise[1]),
        chest_fade=np.float32(neck.chest_fade),
        least=np.float32(regions.least),
        most=np.float32(regions.most),
    )


_COEFFICIENTS = _coefficients(SKIN_PRIOR)


def _grown_hulls(shape: tuple[int, int], points: Floats, groups: tuple[layout.Indices, ...], margin: float) -> Bools:
    """(h, w) bool: the hulls of groups of landmarks, grown by a margin in cells."""
    out = np.zeros(shape, np.uint8)
    for indices in groups:
        out |= _fill(shape, _hull(points[indices])).astype(np.uint8)
    radius = max(1, round(margin))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return cv2.dilate(out, kernel).astype(np.bool_)


def _distance(mask: Bools) -> Floats:
    """(h, w) float32 distance of every cell of `mask` to the next cell outside it."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5), np.float32)


def _fill(shape: tuple[int, int], polygon: Floats) -> Bools:
    """(h, w) bool, true inside a polygon (n, 2)."""
    out = np.zeros(shape, np.uint8)
    far = 2 * max(*shape, 4096)
    fixed = fixed_point(np.clip(polygon, -far, far))
    cv2.fillPoly(out, [fixed], (1,), lineType=cv2.LINE_8, shift=SUBPIXEL_BITS)
    return out.astype(np.bool_)


def _hull(points: Floats) -> Floats:
    """Convex hull (n, 2) of points."""
    corners: Floats = cv2.convexHull(np.ascontiguousarray(points, np.float32))[:, 0].astype(np.float32)
    return corners
