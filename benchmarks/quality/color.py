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
_CHROMA_KNEE = 25.0**7


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


def delta_e_2000(first: Any, second: Any) -> Floats:
    """CIEDE2000 between CIELAB colours (..., 3), weights k_L = k_C = k_H = 1."""
    l1, a1, b1 = np.moveaxis(np.asarray(first, np.float64), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(second, np.float64), -1, 0)
    mean_chroma7 = ((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2.0) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(mean_chroma7 / (mean_chroma7 + _CHROMA_KNEE))
    a1, a2 = a1 * stretch, a2 * stretch
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = np.degrees(np.arctan2(b1, a1)) % 360.0, np.degrees(np.arctan2(b2, a2)) % 360.0
    colored = c1 * c2 > 0.0
    turn = np.where(colored, (h2 - h1 + 180.0) % 360.0 - 180.0, 0.0)
    hue = np.where(colored, (h1 + turn / 2.0) % 360.0, h1 + h2)
    d_hue = 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2.0))
    lightness, chroma = (l1 + l2) / 2.0, (c1 + c2) / 2.0
    t = (
        1.0
        - 0.17 * np.cos(np.radians(hue - 30.0))
        + 0.24 * np.cos(np.radians(2.0 * hue))
        + 0.32 * np.cos(np.radians(3.0 * hue + 6.0))
        - 0.20 * np.cos(np.radians(4.0 * hue - 63.0))
    )
    s_l = 1.0 + 0.015 * (lightness - 50.0) ** 2 / np.sqrt(20.0 + (lightness - 50.0) ** 2)
    s_c, s_h = 1.0 + 0.045 * chroma, 1.0 + 0.015 * chroma * t
    swing = 60.0 * np.exp(-(((hue - 275.0) / 25.0) ** 2))
    twist = -np.sin(np.radians(swing)) * 2.0 * np.sqrt(chroma**7 / (chroma**7 + _CHROMA_KNEE))
    d_l, d_c, d_h = (l2 - l1) / s_l, (c2 - c1) / s_c, d_hue / s_h
    return np.asarray(np.sqrt(np.maximum(d_l**2 + d_c**2 + d_h**2 + twist * d_c * d_h, 0.0)))
