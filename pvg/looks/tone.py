"""One smooth map of colour, regressed from the transport of the open skin: tone by a curve, chroma by tone.

Transport matches extremes to extremes: between a flatly lit face and a shaded one it would turn the slightest
unevenness into blotches, and moved apart from each other the three channels stain shadows and brows. What light and
pigment do to a skin is smoother: a tone curve, and for each tone a chroma. The map F keeps just that of the transport.

    Y' = T(Y)                              T monotone, through black, rolling off to white
    c' = m'(T(Y)) + k (c − m(Y))           m, m': the chroma that is usual at a luma, before and after

Brows, sockets and the shadow of a fringe lie on the same curve as the skin, so they keep their hue; and F's own slope
is the λ to draw with: u' = λI + H(g' − λg) is F(I) linearised at the low frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Doubles, Floats

_LUMA = np.array([0.299, 0.587, 0.114])
_QUANTILES = (0.03, 0.10, 0.25, 0.50, 0.75, 0.90, 0.97)
_SLOPES = (0.55, 1.7)  # of the tone curve between two quantiles [by eye: outside, blotches or a flat wash]
_SMOOTH_LEVELS = 7  # width of the box that rounds the tone curve's corners
_LEAST_STEP = 0.25  # levels added to both sides of a slope, so that skin of one tone has one
_SPREAD_RANGE = (0.6, 1.4)  # of k, the ratio of the spreads of chroma at a tone [by eye]
_CONTRAST_RANGE = (0.6, 2.0)  # of λ for luma [by eye]
_CHROMA_RANGE = (0.5, 1.1)  # of λ for chroma [by blind choice: with 1.5 skin is called red or burnt]
_LEAST_CHROMA = 4.0  # levels added to both sides of the ratio of chroma, so that grey skin does not explode
# of the way from the line that is seen to the one of constant hue and saturation: light from two sides colours shadows,
# and whole ones would turn sockets and stubble violet [by eye]
_OWN_HUE = 0.5
_LEAST_LUMA_SPREAD = 4.0  # levels: skin of less spread says nothing of how chroma changes with luma


def to_opponent(colors: Floats | Doubles) -> Doubles:
    """RGB (n, 3) as luma, B − Y and R − Y, levels of 255."""
    luma = colors @ _LUMA
    return np.stack([luma, colors[:, 2] - luma, colors[:, 0] - luma], axis=1)


def to_rgb(opponent: Doubles) -> Doubles:
    """The inverse of `to_opponent`."""
    luma, blue, red = opponent.T
    r, b = luma + red, luma + blue
    return np.stack([r, (luma - _LUMA[0] * r - _LUMA[2] * b) / _LUMA[1], b], axis=1)


@dataclass(frozen=True, eq=False)
class UsualChroma:
    """The chroma (2,) that is usual at a luma: a line between `low` and `high`, fading to grey at black and white.

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
        low, high = np.quantile(luma, (_QUANTILES[0], _QUANTILES[-1]))
        return cls(mean - slope * middle, slope, max(float(low), 1.0), min(float(high), 254.0))

    def at(self, luma: Doubles) -> Doubles:
        """(n, 2) at lumas (n,)."""
        inside = np.clip(luma, self.low, self.high)
        fade = np.minimum(np.maximum(luma, 0.0) / self.low, (255.0 - np.minimum(luma, 255.0)) / (255.0 - self.high))
        return np.asarray((self.start + self.slope * inside[:, None]) * np.clip(fade, 0.0, 1.0)[:, None])


def tone_curve(source: Doubles, target: Doubles) -> Doubles:
    """T as a table (256,): luma of `source` (n,) to that of `target` (m,), quantile by quantile, slopes bounded."""
    s, t = np.quantile(source, _QUANTILES), np.quantile(target, _QUANTILES)
    middle = len(s) // 2
    gaps = np.diff(s)
    rise = np.clip((np.diff(t) + _LEAST_STEP) / (gaps + _LEAST_STEP), *_SLOPES) * gaps
    t = t[middle] + np.concatenate([-np.cumsum(rise[:middle][::-1])[::-1], [0.0], np.cumsum(rise[middle:])])
    kept = (s > 0.0) & (s < 255.0) & (t > 0.0) & (t < 255.0)
    s, t = s[kept], t[kept]
    white = min(255.0, t[-1] + _SLOPES[1] * (255.0 - s[-1]))
    levels = np.arange(256.0)
    table = np.interp(levels, np.concatenate([[0.0], s, [255.0]]), np.concatenate([[0.0], t, [white]]))
    half = _SMOOTH_LEVELS // 2
    # continued through both ends by point reflection, so that black stays black
    padded = np.concatenate([-table[half:0:-1], table, 2 * table[-1] - table[-2 : -2 - half : -1]])
    return np.asarray(np.convolve(padded, np.full(_SMOOTH_LEVELS, 1.0 / _SMOOTH_LEVELS), mode="valid"))


@dataclass(frozen=True, eq=False)
class SkinMap:
    """The map F of a skin's colours to another's.

    tone: (256,) T;  own, goal: the usual chroma before and after;  spread: k;  chroma_contrast: λ for chroma.
    """

    tone: Doubles
    own: UsualChroma
    goal: UsualChroma
    spread: float
    chroma_contrast: float

    @classmethod
    def between(cls, skin: Floats, moved: Doubles) -> SkinMap:
        """F for open-skin colours `skin` (n, 3) that the transport moved to `moved` (n, 3), 0-255 RGB."""
        source, target = to_opponent(skin), to_opponent(moved)
        own, goal = UsualChroma.of(source), UsualChroma.of(target)
        around, wanted = source[:, 1:] - own.at(source[:, 0]), target[:, 1:] - goal.at(target[:, 0])
        spread = np.sqrt(((wanted**2).sum(axis=1).mean() + 1.0) / ((around**2).sum(axis=1).mean() + 1.0))
        chroma = [float(np.hypot(*one[:, 1:].mean(axis=0))) + _LEAST_CHROMA for one in (target, source)]
        return cls(
            tone_curve(source[:, 0], target[:, 0]),
            own,
            goal,
            float(np.clip(spread, *_SPREAD_RANGE)),
            float(np.clip(chroma[0] / chroma[1], *_CHROMA_RANGE)),
        )

    def __call__(self, colors: Floats) -> Doubles:
        """Map (n, 3) colours, 0-255 RGB; the result may leave that range."""
        opponent = to_opponent(colors)
        luma = np.interp(opponent[:, 0], np.arange(256.0), self.tone)
        chroma = self.goal.at(luma) + self.spread * (opponent[:, 1:] - self.own.at(opponent[:, 0]))
        return to_rgb(np.column_stack([luma, chroma]))

    def contrast(self, colors: Floats) -> Floats:
        """λ of luma and of chroma (n, 2) at colours (n, 3): F's own slope.

        T' alone is flat where a dim face is made bright, T/Y alone flat where a pale face is made dark: their geometric
        mean.
        """
        luma = np.clip(to_opponent(colors)[:, 0], 1.0, 255.0)
        levels = np.arange(256.0)
        rise, level = np.interp(luma, levels, np.gradient(self.tone)), np.interp(luma, levels, self.tone)
        contrast = np.clip(np.sqrt(rise * level / luma), *_CONTRAST_RANGE)
        return np.stack([contrast, np.full(len(colors), self.chroma_contrast)], axis=1).astype(np.float32)
