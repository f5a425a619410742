"""Made-up curves and domains for the tests of the fit."""

from __future__ import annotations

import numpy as np


def ellipse(cx: float, cy: float, a: float, b: float, step: float = 1.0) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, max(8, int(np.pi * (a + b) / step)), endpoint=False)
    return np.stack([cx + a * np.cos(t), cy + b * np.sin(t)], axis=1)


def disc(size: int, radius: float) -> np.ndarray:
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return x**2 + y**2 < radius**2
