"""Colours as luma and two differences to it, in which tone and chroma move apart."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.picture import LUMA


def luma_of(colors: Floats | Doubles) -> Doubles:
    """(n,) luma of RGB (n, 3)."""
    return np.asarray(colors @ LUMA)


def median_luma(colors: Floats | Doubles) -> float:
    """Median luma of RGB (n, 3), at least 1."""
    return max(float(np.median(luma_of(colors))), 1.0)


def to_opponent(colors: Floats | Doubles) -> Doubles:
    """RGB (n, 3) as luma, B − Y and R − Y, levels of 255."""
    luma = luma_of(colors)
    return np.stack([luma, colors[:, 2] - luma, colors[:, 0] - luma], axis=1)


def to_rgb(opponent: Doubles) -> Doubles:
    """The inverse of `to_opponent`."""
    luma, blue, red = opponent.T
    r, b = luma + red, luma + blue
    return np.stack([r, (luma - LUMA[0] * r - LUMA[2] * b) / LUMA[1], b], axis=1)
