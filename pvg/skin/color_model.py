"""Colour models of skin and of what surrounds it: smoothed Lab histograms and their log-likelihood ratio."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Floats
from pvg.skin._kernels import level_chroma

_CHROMA_L, _DARKEST_L = 54.0, 24.0  # chroma is told as if L were 54, as far down as L 24
_BINS = 48
_REACH = 9.0  # the histograms cover the skin's median ± so many spreads; colours beyond share the outer bins
_BLUR = 1.4  # bins
_SKIN_FLOOR, _AROUND_FLOOR = 0.03, 0.3  # of a uniform distribution over all bins
_LIGHT_DISCOUNT = 0.7
_LEAST_SPREAD = np.array([5.0, 1.6, 1.6], np.float32)
_MOST_SPREAD = np.array([9.0, 3.2, 3.2], np.float32)


def to_skin_lab(rgb: Bytes) -> Floats:
    """(h, w, 3) float32: CIE L in [0, 100], and a, b brought to one lightness.

    Under weaker light of the same colour L + 16, a and b fall in proportion, so a/(L + 16) and b/(L + 16) stay: skin
    in the shade keeps the chroma of skin in the light. Noise forbids it for the darkest colours.
    """
    lab: Floats = cv2.cvtColor(np.asarray(rgb, np.float32) / 255, cv2.COLOR_RGB2Lab).astype(np.float32)
    level_chroma(lab, np.float32(_CHROMA_L), np.float32(_DARKEST_L))
    return lab


@dataclass(frozen=True, eq=False)
class ColorScale:
    """Lab measured in the skin's own terms: z = (lab − center) / spread.

    center, spread: (3,) float32. Grey and dim pictures have little chroma to tell by, so the spread is the sample's.
    """

    center: Floats
    spread: Floats

    def standard(self, lab: Floats) -> Floats:
        """Standardised colours, any leading axes."""
        z: Floats = (lab - self.center) / self.spread
        return z

    def bins(self, lab: Floats) -> NDArray[np.intp]:
        """Flat histogram index of every colour of lab (…, 3)."""
        z = (self.standard(lab) + _REACH) * (_BINS / (2 * _REACH))
        index = np.clip(z, 0, _BINS - 1).astype(np.intp)
        flat: NDArray[np.intp] = (index[..., 0] * _BINS + index[..., 1]) * _BINS + index[..., 2]
        return flat

    def cell(self) -> tuple[Floats, Floats, np.float32, int]:
        """What `bins` reckons with: the centre, bins a unit of Lab, the centre's bin, and the bins along an axis."""
        unit = _BINS / (2 * _REACH)
        return self.center, (unit / self.spread).astype(np.float32), np.float32(_REACH * unit), _BINS


def skin_scale(sample: Floats) -> ColorScale:
    """The colour scale of a sample of skin (n, 3) Lab: its median and robust spread, within bounds."""
    center = np.median(sample, axis=0)
    spread = 1.4826 * np.median(np.abs(sample - center), axis=0)
    return ColorScale(center.astype(np.float32), np.clip(1.3 * spread, _LEAST_SPREAD, _MOST_SPREAD).astype(np.float32))


def density(bins: NDArray[np.intp], weights: Floats) -> Floats:
    """Smoothed histogram (_BINS³,) of total 1 of colours with weights (both (n,))."""
    cube: Floats = np.bincount(bins, weights=weights, minlength=_BINS**3).astype(np.float32)
    for _ in range(3):  # blur along the first axis, then bring the next one to the front
        rows = cube.reshape(_BINS, _BINS * _BINS)
        blurred = cv2.GaussianBlur(rows, (1, 9), sigmaX=0.1, sigmaY=_BLUR, borderType=cv2.BORDER_REPLICATE)
        cube = np.asarray(blurred, np.float32).T.ravel()
    total: Floats = (cube / max(float(cube.sum()), 1e-9)).astype(np.float32)
    return total


@dataclass(frozen=True, eq=False)
class SkinColors:
    """How much likelier each colour is on skin than around it.

    table: (_BINS³,) float32 log-likelihood ratio over the bins of `scale`.
    """

    scale: ColorScale
    table: Floats

    def evidence(self, lab: Floats) -> Floats:
        """Log-likelihood ratio of lab (h, w, 3), as (h, w)."""
        ratio: Floats = self.table[self.scale.bins(lab)]
        return ratio


def fit_colors(scale: ColorScale, lab: Floats, skin: Floats, around: Floats, *, limit: float = 5.0) -> SkinColors:
    """Colour models from a picture lab (h, w, 3) and weights of skin and surroundings (h, w)."""
    bins = scale.bins(lab).ravel()
    inner, outer = density(bins, skin.ravel()), density(bins, around.ravel())
    # floors: a colour seen on neither side is more likely not skin, for skin's colours are few and mostly seen
    table = np.log((inner + _SKIN_FLOOR / _BINS**3) / (outer + _AROUND_FLOOR / _BINS**3))
    return SkinColors(scale, np.clip(table, -limit, limit).astype(np.float32))


def strangeness(lab: Floats, sample: Floats, shaded: Bools) -> tuple[Floats, Floats]:
    """How far colours lab (h, w, 3) are from a sample of skin (n, 3), in squared spreads: (h, w) with all of L, and
    (h, w) with little of it.

    Where the skin has a hue, greys count as far: shirts, grey hair, teeth. Dark ones do not in `shaded` (h, w) bool,
    where they may be a forehead under a hat.
    """
    center = np.median(sample, axis=0)
    spread = np.maximum(1.3 * 1.4826 * np.median(np.abs(sample - center), axis=0), _LEAST_SPREAD)
    squares = ((lab - center) / spread) ** 2
    tone = center[1:]
    chroma = max(float(np.hypot(*tone)), 1.0)
    saturation = (lab[..., 1:] @ tone) / chroma**2  # 1 for the sample's own, 0 for greys
    grey = 225 * np.maximum(0, 0.55 - saturation) ** 2
    grey *= min(1.0, chroma / 10) * np.where(shaded, np.clip((lab[..., 0] - 15) / 20, 0, 1), 1)
    far = squares.sum(axis=2) + grey
    return far.astype(np.float32), (far - _LIGHT_DISCOUNT * squares[..., 0]).astype(np.float32)
