"""Made-up skins, and colours of any kind, by a seed."""

from __future__ import annotations

import numpy as np


def skin_like(seed: int) -> np.ndarray:
    """(300, 3) float32 RGB around one colour, 0-255."""
    rng = np.random.default_rng(seed)
    return (rng.uniform(60, 200, 3) + rng.normal(0, rng.uniform(4, 20), (300, 3))).clip(0, 255).astype(np.float32)


def any_colors(seed: int) -> np.ndarray:
    """(50, 3) float32 RGB, 0-255."""
    return np.random.default_rng(seed).uniform(0, 255, (50, 3)).astype(np.float32)
