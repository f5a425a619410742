"""Colour models of skin and of its surroundings: smoothed Lab histograms and their log-likelihood ratio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Floats, ramp
from pvg.skin._kernels import normalize_chroma
from pvg.skin.parameters import SKIN_PRIOR

MAD_TO_SIGMA: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

LEAST_CHROMA: Final = 1.0
"""Of Lab: below it a hue has no direction."""

_COLORS = SKIN_PRIOR.colors
_BINS = _COLORS.bins
_LEAST_SPREAD, _MOST_SPREAD = (np.array(s, np.float32) for s in (_COLORS.least_spread, _COLORS.most_spread))
_LAST_AXIS_SIGMA = 0.1  # any: OpenCV wants one for the side along which the kernel is 1 wide


def to_skin_lab(rgb: Bytes) -> Floats:
    """(h, w, 3) float32: CIE L in [0, 100], and a, b brought to one lightness.

    Under weaker light of the same colour L + 16, a and b fall in proportion, so a/(L + 16) and b/(L + 16) stay: skin
    in the shade keeps the chroma of skin in the light. Noise forbids it for the darkest colours.
    """
    lab: Floats = cv2.cvtColor(np.asarray(rgb, np.float32) / 255, cv2.COLOR_RGB2Lab).astype(np.float32)
    normalize_chroma(lab, np.float32(_COLORS.lightness), np.float32(_COLORS.darkest))
    return lab


def median_deviation(sample: Floats, center: Floats) -> Floats:
    """Median absolute deviation (k,) of a sample (n, k) from its center (k,)."""
    deviation: Floats = np.median(np.abs(sample - center), axis=0)
    return deviation


def inlier_covariance(sample: Floats, center: Floats, inlier: float, margin: float) -> Floats:
    """Covariance (k, k) of a sample (n, k) about its center (k,), strays left out; 0 where all are.

    A stray is further off in any channel than `inlier` robust standard deviations and a `margin`.
    """
    limit = inlier * MAD_TO_SIGMA * median_deviation(sample, center) + margin
    offset = sample - center
    inliers = offset[(np.abs(offset) <= limit).all(axis=1)]
    covariance: Floats = inliers.T @ inliers / max(len(inliers), 1)
    return covariance


@dataclass(frozen=True, eq=False)
class ColorScale:
    """Lab measured in the skin's own terms: z = (lab − center) / spread.

    center, spread: (3,) float32. Grey and dim pictures have little chroma to tell by, so the spread is the sample's.
    """

    center: Floats
    spread: Floats

    @classmethod
    def fit(cls, sample: Floats) -> ColorScale:
        """The scale of a sample of skin (n, 3) Lab: its median and robust spread, within bounds."""
        center = np.median(sample, axis=0)
        spread = MAD_TO_SIGMA * median_deviation(sample, center)
        bounded = np.clip(_COLORS.spread_factor * spread, _LEAST_SPREAD, _MOST_SPREAD)
        return cls(center.astype(np.float32), bounded.astype(np.float32))

    def of_hue(self, lab: Floats) -> tuple[Floats, Floats]:
        """How far colours lab (…, 3) are from the skin's, in spreads: along its hue, away from grey, and across it.

        Across the hue what is below 0 is redder, what is above yellower.
        """
        tone = self.center[1:]
        chroma = max(float(np.hypot(*tone)), LEAST_CHROMA)
        unit = chroma * float(self.spread[1:].mean())
        off = lab[..., 1:] - tone
        across = off[..., 1] * tone[0] - off[..., 0] * tone[1]
        return np.asarray(off @ tone / unit, np.float32), np.asarray(across / unit, np.float32)

    def bins(self, lab: Floats) -> NDArray[np.intp]:
        """Flat histogram index of every colour of lab (…, 3)."""
        z = ((lab - self.center) / self.spread + _COLORS.reach) * (_BINS / (2 * _COLORS.reach))
        index = np.clip(z, 0, _BINS - 1).astype(np.intp)
        flat: NDArray[np.intp] = (index[..., 0] * _BINS + index[..., 1]) * _BINS + index[..., 2]
        return flat

    def binning(self) -> tuple[Floats, Floats, np.float32, int]:
        """What `bins` computes with: the center, bins a unit of Lab, the center's bin, and the bins along an axis."""
        unit = _BINS / (2 * _COLORS.reach)
        return self.center, (unit / self.spread).astype(np.float32), np.float32(_COLORS.reach * unit), _BINS


def histogram_density(bins: NDArray[np.intp], weights: Floats) -> Floats:
    """Smoothed histogram (bins³,) of total 1 of colours with weights (both (n,))."""
    cube: Floats = np.bincount(bins, weights=weights, minlength=_BINS**3).astype(np.float32)
    size, blur = (1, _COLORS.blur_width), _COLORS.blur
    for _ in range(3):  # blur along the first axis, then bring the next one to the front
        rows = cube.reshape(_BINS, _BINS * _BINS)
        blurred = cv2.GaussianBlur(rows, size, sigmaX=_LAST_AXIS_SIGMA, sigmaY=blur, borderType=cv2.BORDER_REPLICATE)
        cube = np.asarray(blurred, np.float32).T.ravel()
    total: Floats = (cube / max(float(cube.sum()), 1e-9)).astype(np.float32)
    return total


@dataclass(frozen=True, eq=False)
class SkinColors:
    """How much likelier each colour is on skin than around it.

    log_ratio: (bins³,) float32, ln p(colour | skin) − ln p(colour | surroundings) over the bins of `scale`.
    """

    scale: ColorScale
    log_ratio: Floats

    @classmethod
    def fit(cls, scale: ColorScale, bins: NDArray[np.intp], skin: Floats, around: Floats) -> SkinColors:
        """The models of a picture whose cells have the colours `bins` of a scale and weights, (h, w) each.

        skin, around: weights as skin and as surroundings.
        """
        flat = bins.ravel()
        inner, outer = histogram_density(flat, skin.ravel()), histogram_density(flat, around.ravel())
        # floors: a colour seen on neither side is more likely not skin, for skin's colours are few and mostly seen
        ratio = np.log((inner + _COLORS.skin_floor / _BINS**3) / (outer + _COLORS.around_floor / _BINS**3))
        return cls(scale, np.clip(ratio, -_COLORS.most_log_ratio, _COLORS.most_log_ratio).astype(np.float32))

    def evidence(self, lab: Floats) -> Floats:
        """Log-likelihood ratio of lab (h, w, 3), as (h, w)."""
        return self.evidence_of(self.scale.bins(lab))

    def evidence_of(self, bins: NDArray[np.intp]) -> Floats:
        """The same of colours that are known by their `bins` (h, w)."""
        ratio: Floats = self.log_ratio[bins]
        return ratio


def squared_distances(lab: Floats, sample: Floats, shaded: Bools) -> tuple[Floats, Floats]:
    """Squared Mahalanobis distances of colours lab (h, w, 3) to a sample of skin (n, 3), axes taken as independent.

    Returns the distance (h, w), and the tonal one (h, w) in which lightness counts little. Where the skin has a hue,
    greys count as far: shirts, grey hair, teeth. Dark ones do not in `shaded` (h, w) bool, where they may be a forehead
    under a hat.
    """
    center = np.median(sample, axis=0)
    spread = np.maximum(_COLORS.spread_factor * MAD_TO_SIGMA * median_deviation(sample, center), _LEAST_SPREAD)
    squares = ((lab - center) / spread) ** 2
    tone = center[1:]
    chroma = max(float(np.hypot(*tone)), LEAST_CHROMA)
    saturation = (lab[..., 1:] @ tone) / chroma**2  # 1 for the sample's own, 0 for greys
    grey = _COLORS.grey * np.maximum(0, _COLORS.least_saturation - saturation) ** 2
    in_light = ramp(lab[..., 0], *_COLORS.shade_rise)
    grey *= min(1.0, chroma / _COLORS.full_chroma) * np.where(shaded, in_light, 1)
    distance = squares.sum(axis=2) + grey
    tonal = distance - _COLORS.lightness_discount * squares[..., 0]
    return distance.astype(np.float32), tonal.astype(np.float32)
