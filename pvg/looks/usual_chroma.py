"""The chroma that a skin usually has at a luma: m of the map F (`pvg.looks.skin_map`).

Light and shade move a skin along a line of chroma by luma: what lies on it is skin in some light, what lies off it is a
flush, a freckle, or no skin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.looks.opponent import to_rgb

LEAST_TINGE = 3.0
"""e of `pvg.rendering.tinge`, levels [by eye]."""
SEEN = (0.03, 0.97)
"""Quantiles of a skin's luma, between which it is seen."""

# of the way from the line that is seen to the one of constant hue and saturation: light from two sides colours shadows,
# and whole ones would turn sockets and stubble violet [by eye]
_OWN_HUE = 0.5
_LEAST_LUMA_SPREAD = 4.0  # levels: skin of less spread says nothing of how chroma changes with luma


@dataclass(frozen=True, eq=False)
class UsualChroma:
    """The chroma (2,) that is usual at a luma: a line between `low` and `high`, fading to grey at black and white.

    No channel of it is above white: skin that is burnt out has no chroma left, and is skin.

    start, slope: (2,) of the line at luma 0;  low, high: the lumas it was seen between.
    """

    start: Doubles
    slope: Doubles
    low: float
    high: float

    @classmethod
    def of(cls, opponent: Doubles) -> UsualChroma:
        """The line through colours (n, 3) of `to_opponent`, by least squares, half way to constant saturation."""
        luma, chroma = opponent[:, 0], opponent[:, 1:]
        middle, mean = luma.mean(), chroma.mean(axis=0)
        spread = max(float(((luma - middle) ** 2).mean()), _LEAST_LUMA_SPREAD**2)
        slope = ((luma - middle)[:, None] * (chroma - mean)).mean(axis=0) / spread
        slope += _OWN_HUE * (mean / max(middle, 1.0) - slope)
        low, high = np.quantile(luma, SEEN)
        return cls(mean - slope * middle, slope, max(float(low), 1.0), min(float(high), 254.0))

    @property
    def brightest(self) -> float:
        """`high`, some levels above `low` at least."""
        return max(self.high, self.low + _LEAST_LUMA_SPREAD)

    @property
    def middle(self) -> float:
        """Luma half way through the skin's."""
        return 0.5 * (self.low + self.brightest)

    def up_to(self, luma: float) -> UsualChroma:
        """The same line, seen up to a luma at least: what is as bright as that is skin, and no glare."""
        return replace(self, high=min(max(self.high, luma), 254.0))

    def at(self, luma: Doubles) -> Doubles:
        """(n, 2) at lumas (n,)."""
        inside = np.clip(luma, self.low, self.high)
        fade = np.minimum(np.maximum(luma, 0.0) / self.low, (255.0 - np.minimum(luma, 255.0)) / (255.0 - self.high))
        line = self.start + self.slope * inside[:, None]
        beyond = to_rgb(np.column_stack([np.zeros(len(line)), line])).max(axis=1)
        fade = np.clip(fade, 0.0, 1.0) * np.minimum(1.0, (255.0 - inside) / np.maximum(beyond, 1e-6))
        return np.asarray(line * fade[:, None])

    def likeness(self, opponent: Doubles) -> Doubles:
        """r (n,) of colours (n, 3) of `to_opponent`: 1 of the usual chroma and 0 of grey, see `pvg.rendering.tinge`."""
        return likeness(opponent[:, 1:], self.at(opponent[:, 0]), LEAST_TINGE)


def likeness(chroma: Doubles | Floats, usual: Doubles, least: float | Doubles) -> Doubles:
    """r (n,) of chroma (n, 2) beside the usual one (n, 2), e = `least`, see `pvg.rendering.tinge`, on one scale."""
    blue, red = usual.T
    size = np.sqrt(blue * blue + red * red)
    along = (chroma[:, 0] * blue + chroma[:, 1] * red) / np.maximum(size, 1e-6)
    return np.asarray((along + least) / (size + least))
