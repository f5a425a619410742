"""The map of a skin's colours to another skin's, with no more freedom than light and skin have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats

_LUMA = np.array([0.299, 0.587, 0.114])
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
