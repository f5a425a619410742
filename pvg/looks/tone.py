"""The colours of a face's open skin, evenly over the face: what a complexion is moved from and to.

Curve samples crowd at features and edges, so their distribution is not that of the skin between them; a beard is in
the skin's place but not of its colour. These samples lie on a grid over the face without features, and leave the
lower face out when it is much unlike the upper one.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg.curves.labels import Floats, face_frame

SAMPLES = 512
_LUMA = np.array([0.299, 0.587, 0.114])
_OVAL = slice(0, 36)  # of the skin points
_FEATURES: tuple[tuple[int, ...], ...] = (
    (33, 34, 35, 36, 37, 64, 65, 66, 67),
    (38, 39, 40, 41, 42, 68, 69, 70, 71),
    (52, 53, 54, 55, 56, 57, 72, 73),
    (58, 59, 60, 61, 62, 63, 75, 76),
    (47, 48, 49, 50, 51, 82, 83),
    tuple(range(84, 96)),
)
_MARGIN = 0.035  # of the face's width, around features and inside the oval
_SMOOTHING = 0.01
_UNLIKE = 20.0  # CIE76 difference of the medians of upper and lower face that stands for a beard or a veil
_LEAST = 24  # fewer samples say nothing


def skin_sample(rgb: NDArray[np.uint8], skin: Floats, points: Floats, skin_points: Floats) -> Floats:
    """Colours of the open skin of one face: (SAMPLES, 3) float32, 0-255 RGB, or (0, 3) when there is too little.

    rgb: (H, W, 3);  skin: (H, W) float32, the matte;  points: (106, 2);  skin_points: (88, 2), all in its pixels.
    """
    frame = face_frame(points)
    h, w = rgb.shape[:2]
    region = np.zeros((h, w), np.uint8)
    cv2.fillPoly(region, [np.rint(skin_points[_OVAL]).astype(np.int32)], 1)
    reach = max(3, 2 * int(frame.width * _MARGIN) + 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    region = np.asarray(cv2.erode(region, kernel, borderValue=0), np.uint8)
    features = np.zeros((h, w), np.uint8)
    for feature in _FEATURES:
        cv2.fillConvexPoly(features, cv2.convexHull(np.rint(points[list(feature)]).astype(np.int32)), 1)
    region[np.asarray(cv2.dilate(features, kernel)) > 0] = 0
    rows, columns = np.nonzero((region > 0) & (skin > 0.9))
    if len(rows) < _LEAST:
        return np.empty((0, 3), np.float32)
    smooth = cv2.GaussianBlur(rgb, (0, 0), max(0.6, _SMOOTHING * frame.width)).astype(np.float32)
    colors = smooth[rows, columns]
    nose_tip = points[46]
    below = (np.stack([columns, rows], axis=1) - nose_tip) @ frame.down > 0
    colors = _without_beard(colors, below)
    # pixels come row by row, so equal steps through them are spread evenly over the face
    chosen = np.linspace(0, len(colors) - 1, SAMPLES).round().astype(int)
    return np.ascontiguousarray(colors[chosen], np.float32)


def _without_beard(colors: Floats, lower: NDArray[np.bool_]) -> Floats:
    if min(int(lower.sum()), int((~lower).sum())) < _LEAST:
        return colors
    lab = cv2.cvtColor(colors[None] / np.float32(255.0), cv2.COLOR_RGB2Lab)[0]
    gap = float(np.linalg.norm(np.median(lab[lower], axis=0) - np.median(lab[~lower], axis=0)))
    return colors[~lower] if gap > _UNLIKE else colors


_RATIO_RANGE = (0.3, 2.5)
_RATIO_FLOOR = 8.0  # levels added to both sides of a ratio, so that near-black does not explode
_GAIN_RANGE = (0.6, 1.3)
_FAR = (2.0, 6.0)  # spreads: a colour beyond the first is ever less skin, beyond the second none


@dataclass(frozen=True, eq=False)
class ComplexionMap:
    """The map of a skin's colours to another skin's, with no more freedom than light and skin have.

    Transport matches extremes to extremes: between a flatly lit face and a shaded one it would turn the slightest
    unevenness into blotches. Of its result this keeps where the skin goes (the medians), a gain per channel (their
    ratio, as another light or pigment would), and the spread within 0.6 to 1.3 of what the ratio makes of it.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    ratio: NDArray[np.float64]
    gain: float
    spread: float

    @classmethod
    def between(cls, skin: Floats, moved: NDArray[np.float64]) -> ComplexionMap:
        """The map of open-skin colours `skin` (n, 3) to where transport `moved` them, (n, 3)."""
        start, end = np.median(skin, axis=0).astype(np.float64), np.median(moved, axis=0)
        ratio = np.clip((end + _RATIO_FLOOR) / (start + _RATIO_FLOOR), *_RATIO_RANGE)
        scaled = (skin - start) * ratio
        spread = float(np.sqrt((scaled**2).sum(axis=1).mean())) + 1e-6
        gain = float(np.clip(np.sqrt(((moved - end) ** 2).sum(axis=1).mean()) / spread, *_GAIN_RANGE))
        return cls(start, end, ratio, gain, spread)

    def __call__(self, colors: Floats) -> NDArray[np.float64]:
        """Map (n, 3) colours. What is far from skin (a brow, a lash) follows the light alone, without the gain."""
        scaled = (colors - self.start) * self.ratio
        distance = np.linalg.norm(scaled, axis=1, keepdims=True) / self.spread
        like_skin = np.clip((_FAR[1] - distance) / (_FAR[1] - _FAR[0]), 0.0, 1.0)
        mapped: NDArray[np.float64] = self.end + (1.0 + like_skin * (self.gain - 1.0)) * scaled
        return mapped

    @property
    def brightness(self) -> float:
        """The ratio of brightness, at most 1.5 either way."""
        return float(np.clip(self.ratio @ _LUMA, 1 / 1.5, 1.5))
