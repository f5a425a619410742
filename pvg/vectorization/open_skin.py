"""The colours of a face's open skin, evenly over the face: what a complexion is moved from and to.

Curve samples crowd at features and edges, so their distribution is not that of the skin between them; a beard is in
the skin's place but not of its colour, and so is a mask. These samples lie on a grid over the face without features,
and leave the lower face out when it is much unlike the upper one, and what is below the eyes where its hue is much
unlike the forehead's.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Floats
from pvg.face import Landmarks, layout
from pvg.picture import LUMA
from pvg.raster import inside

SAMPLES = 512
_FEATURES = (
    layout.LEFT_BROW,
    layout.RIGHT_BROW,
    layout.LEFT_EYE,
    layout.RIGHT_EYE,
    layout.NOSE_BASE_TO_WINGS,
    layout.LIPS_OUTER,
)
_MARGIN = 0.035  # of the face's width, around features and inside the oval
_SMOOTHING = 0.01
# CIE76 difference of the medians of upper and lower face that stands for a beard, which is darker, in light in which
# the upper one has that luma: in dim light all differences are small, and a beard would come and go with it [measured:
# bearded lower faces are 17.4 to 36 from the upper ones, shaded ones and short stubble at most 16.6]
_BEARD, _LIGHT = 17.0, 140.0
_VEIL = 18.0  # the same for a brighter veil, in equal light: a hat may shade the upper face alone [by eye]
_MASK = 16.0  # CIELAB difference in hue and chroma alone, for a shadow of a hat is none [by eye]
# what is farther from the forehead than that in hue and chroma is the rest of what covers the face, if it is no half of
# it: light of two colours is light [by eye: red cheeks are 20 away]
_NO_SKIN, _FEW = 28.0, 0.5
_LEAST = 24  # fewer samples say nothing
_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def skin_sample(rgb: Bytes, skin: Floats, landmarks: Landmarks) -> tuple[Floats, Floats]:
    """The open skin of one face: its colours (SAMPLES, 3) float32, 0-255 RGB, and where they are, (SAMPLES, 2) pixels.

    Both are empty when there is too little of it.  rgb: (H, W, 3);  skin: (H, W) float32, the matte;
    landmarks: in its pixels.
    """
    axes, points = landmarks.axes, landmarks.points
    h, w = rgb.shape[:2]
    reach = max(3, 2 * int(axes.width * _MARGIN) + 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    oval = inside(landmarks.oval, (h, w)).view(np.uint8)
    region = np.asarray(cv2.erode(oval, kernel, borderValue=0), np.uint8)
    features = np.zeros((h, w), np.uint8)
    for feature in _FEATURES:
        cv2.fillConvexPoly(features, cv2.convexHull(np.rint(points[feature]).astype(np.int32)), 1)
    region[np.asarray(cv2.dilate(features, kernel)) > 0] = 0
    rows, columns = np.nonzero((region > 0) & (skin > 0.9))
    if len(rows) < _LEAST:
        return np.empty((0, 3), np.float32), np.empty((0, 2), np.float32)
    smooth = cv2.GaussianBlur(rgb, (0, 0), max(0.6, _SMOOTHING * axes.width)).astype(np.float32)
    colors = smooth[rows, columns]
    places = np.stack([columns, rows], axis=1).astype(np.float32)
    eyes = points[[*layout.LEFT_EYE_CONTOUR, *layout.RIGHT_EYE_CONTOUR]].mean(axis=0)
    lower, under = ((places - level) @ axes.down > 0 for level in (points[layout.NOSE_TIP], eyes))
    kept = _uncovered(colors, lower, under)
    chosen = kept[_spread(rows[kept])]
    return np.ascontiguousarray(colors[chosen], np.float32), places[chosen]


def _spread(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """SAMPLES of the numbers of pixels that come row by row, evenly over their area; rows: (n,) ascending.

    Equal steps through them choose the row, the golden ratio's multiples the place in it. Equal steps alone beat with
    the rows' length: they could fall into a few columns, all on one side of a face, and others after a pixel more.
    """
    steps = np.arange(SAMPLES)
    row = rows[np.linspace(0, len(rows) - 1, SAMPLES).round().astype(int)]
    first, end = (np.searchsorted(rows, row, side) for side in ("left", "right"))
    return np.asarray(first + (steps * _GOLDEN % 1.0 * (end - first)).astype(int), np.intp)


def _uncovered(colors: Floats, lower: Bools, under: Bools) -> NDArray[np.intp]:
    """The numbers of the colours (n, 3) that no beard, veil or mask seems to cover.

    lower, under: (n,) what lies below the nose's tip, and below the eyes.
    """
    kept = np.ones(len(colors), np.bool_)
    step, brighter = _step(colors, lower)
    if not brighter:
        step, _ = _step(_in_light(colors, ~lower), lower)
    if float(np.linalg.norm(step)) > (_VEIL if brighter else _BEARD):
        kept = ~lower
    step, _ = _step(colors[kept], under[kept])
    if float(np.hypot(*step[1:])) > _MASK:
        kept &= ~under
    forehead = kept & ~under
    if int(forehead.sum()) >= _LEAST:
        middle = np.median(colors[forehead], axis=0)
        off = np.linalg.norm(_lab(_no_brighter(colors, middle))[:, 1:] - _lab(middle[None])[:, 1:], axis=1) > _NO_SKIN
        if float(off[kept].mean()) < _FEW:
            kept &= ~off
    return np.flatnonzero(kept)


def _step(colors: Floats, below: Bools) -> tuple[Floats, bool]:
    """(3,) CIELAB from the median above to the one below, and whether that is brighter; 0 with too little of either.

    What is above a brighter one counts as if it were lit as much.
    """
    if min(int(below.sum()), int((~below).sum())) < _LEAST:
        return np.zeros(3, np.float32), False
    lower, upper = (np.median(colors[one], axis=0) for one in (below, ~below))
    brighter = bool(lower.max() > upper.max())
    if brighter:
        upper = upper * (lower.max() / max(upper.max(), 1.0))
    lab = _lab(np.stack([lower, upper]))
    return np.asarray(lab[0] - lab[1]), brighter


def _in_light(colors: Floats, of: Bools) -> Floats:
    """The colours (n, 3) in light in which the median of some of them, (n,), has the luma `_LIGHT`."""
    if not of.any():
        return colors
    luma = max(float(np.median(colors[of], axis=0) @ LUMA), 1.0)
    return np.asarray(colors * np.float32(_LIGHT / luma), np.float32)


def _no_brighter(colors: Floats, than: Floats) -> Floats:
    """The colours (n, 3), those that are brighter in the light in which they are not; than: (3,)."""
    return np.asarray(colors * np.minimum(1.0, than.max() / np.maximum(colors.max(axis=1, keepdims=True), 1.0)))


def _lab(colors: Floats) -> Floats:
    """(n, 3) CIELAB of colours (n, 3), 0-255 RGB."""
    return np.asarray(cv2.cvtColor(colors[None].astype(np.float32) / np.float32(255.0), cv2.COLOR_RGB2Lab)[0])
