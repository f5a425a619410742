"""Colours as people see them: CIELAB, the colour difference CIEDE2000, and the skin-tone angle ITA."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TONE_GROUPS = ("very light", "light", "intermediate", "tan", "brown", "dark")
_TONE_LIMITS = (55.0, 41.0, 28.0, 10.0, -30.0)
# sRGB (IEC 61966-2-1) to CIE XYZ, and its white
_TO_XYZ = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])
_WHITE = np.array([0.95047, 1.0, 1.08883])


def lab(rgb: Any) -> Floats:
    """CIELAB (D65) of (..., 3) sRGB colours on the 0-255 scale."""
    coded = np.asarray(rgb, np.float64) / 255.0
    linear = np.where(coded > 0.04045, ((coded + 0.055) / 1.055) ** 2.4, coded / 12.92)
    x, y, z = np.moveaxis(linear @ _TO_XYZ.T / _WHITE, -1, 0)
    f_x, f_y, f_z = (np.where(t > 216 / 24389, np.cbrt(t), (t * 24389 / 27 + 16) / 116) for t in (x, y, z))
    return np.stack([116 * f_y - 16, 500 * (f_x - f_y), 200 * (f_y - f_z)], axis=-1)


def ita(rgb: Any) -> float:
    """Individual typology angle of one skin colour (3,), degrees: arctan((L - 50) / b)."""
    lightness, _, blue_yellow = lab(rgb)
    return float(np.degrees(np.arctan2(lightness - 50.0, max(blue_yellow, 1e-6))))


def tone_group(angle: float) -> str:
    """The group of an ITA in degrees: very light > 55, light > 41, intermediate > 28, tan > 10, brown > -30, dark."""
    return next(
        (name for name, limit in zip(TONE_GROUPS, _TONE_LIMITS, strict=False) if angle > limit), TONE_GROUPS[-1]
    )


def delta_e_2000(first: Any, second: Any) -> float:
    """CIEDE2000 of two sRGB colours (3,) on the 0-255 scale, by scikit-image."""
    return delta_e_of_labs(lab(first), lab(second))


def delta_e_of_labs(first: Any, second: Any) -> float:
    """CIEDE2000 of two CIELAB colours (3,)."""
    from skimage.color import deltaE_ciede2000  # noqa: PLC0415 - the library itself does without

    difference: Any = deltaE_ciede2000  # which has no types
    return float(difference(first, second))
