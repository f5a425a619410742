"""One smooth map of colour, regressed from the transport of the open skin: tone by a curve, chroma by tone.

Transport matches extremes to extremes: between a flatly lit face and a shaded one it would turn the slightest
unevenness into blotches, and moved apart from each other the three channels stain shadows and brows. What light and
pigment do to a skin is smoother: a tone curve, and for each tone a chroma. The map F keeps just that of the transport.

    Y' = T(Y)                              T monotone, through black, rolling off to white
    c' = m'(T(Y)) + k (c − m(Y))           m, m': the chroma that is usual at a luma, before and after

Brows, sockets and the shadow of a fringe lie on the same curve as the skin, so they keep their hue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.looks.opponent import to_opponent, to_rgb

CRISP = 0.8
"""p of `steeper` where T takes the place of λ. A face made bright by lifted shadows is flat, its brows and beard milky,
its neck bright [by blind choice: 0.8 rather than 0.4 or 0]."""
HIGHLIGHT = 243.0
"""Level of the brightest channel in the brightest of the skin, at most."""

_QUANTILES = (0.03, 0.10, 0.25, 0.50, 0.75, 0.90, 0.97)
# the least and the most of a slope over T/Y, the slope of the same skin in more or less light: what a reference may
# take of the shading that is there [by eye], and what it may add, or it is soot on a cheek [by blind choice: 1.2 rather
# than 1 or 1.5]
_GAINS = (0.55, 1.2)
_FEATURES = 0.45  # of the skin's median luma, below which what is seen in a face is no skin [by eye]
_EVEN = 0.35  # power of the whole curve's slope in each, against blotches where one stretch alone is steep [by eye]
_TO_WHITE = 1.8  # slope above the brightest skin, at most: burnt-out skin gets no whiter than the rest [by eye]
_SMOOTH_LEVELS = 25  # width of the boxes, two of them, that rounds the tone curve's corners
_LEAST_STEP = 0.25  # levels added to both sides of a slope, so that skin of one tone has one
# of k, the ratio of the spreads of chroma at a tone: what differs from the usual chroma dims and greys with the skin
# and never grows, or a flushed nose, freckles and light of two colours turn into orange and green patches [by eye]
_LEAST_SPREAD = 0.5
_FLATTEST = 0.4  # of what may be the most of k
# what is redder or yellower than the rest of the skin looks like a stain on skin of another hue: k falls by that share
# where the saturation, levels of chroma a level of luma, moves by so much [by eye]
_OTHER_HUE, _OTHER = 0.4, 0.08
_OTHER_HUE_BROAD = 0.6  # the same of k at the curves, where it tells of patches: a flushed nose or chin [by eye]
# what gets brighter or darker by half shows it as much as what changes its hue by `_OTHER` [by eye]
_OTHER_LIGHT = 0.5
_ROUNDS = 4  # in which it is found: chroma changes with luma
_MIDDLE = 0.1  # of the middle luma: over which a curve gets steeper below it
_SLOPE_RANGE = (0.6, 2.0)  # of F in luma as a whole [by eye]
# of the middle luma: skin beside the face that is darker than this goes through black [by blind choice: 0.4 rather than
# 0.8 for necks and arms in even shade, 0.8 rather than 0.4 for a shoulder that is modelled by it], and ears
_SHADE, _EAR_SHADE = 0.55, 0.35
_LEAST_CHROMA = 4.0  # levels added to both sides of the ratio of chroma, so that grey skin does not explode
# of the way from the line that is seen to the one of constant hue and saturation: light from two sides colours shadows,
# and whole ones would turn sockets and stubble violet [by eye]
_OWN_HUE = 0.5
LEAST_TINGE = 3.0  # e of `pvg.rendering.tinge`, levels [by eye]
_LEAST_ALIKE = 0.05  # quantile
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
        low, high = np.quantile(luma, (_QUANTILES[0], _QUANTILES[-1]))
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
        usual = self.at(opponent[:, 0])
        size = np.linalg.norm(usual, axis=1)
        along = (opponent[:, 1:] * usual).sum(axis=1) / np.maximum(size, 1e-6)
        return np.asarray((along + LEAST_TINGE) / (size + LEAST_TINGE))


def tone_curve(source: Doubles, target: Doubles, depth: float = 1.0) -> Doubles:
    """T as a table (256,): luma of `source` (n,) to that of `target` (m,), quantile by quantile, slopes bounded.

    depth: in (0, 1], what the luma of features, darker than any skin, is multiplied by besides. Where either is wholly
    black T is the identity.
    """
    s, t = np.quantile(source, _QUANTILES), np.quantile(target, _QUANTILES)
    middle = len(s) // 2
    each = (np.diff(t) + _LEAST_STEP) / (np.diff(s) + _LEAST_STEP)
    whole = (t[-1] - t[0] + _LEAST_STEP) / (s[-1] - s[0] + _LEAST_STEP)
    slopes = each ** (1.0 - _EVEN) * whole**_EVEN
    down, up = slice(middle, None, -1), slice(middle, None)
    for way, steps in ((down, slopes[:middle][::-1]), (up, slopes[middle:])):
        t[way] = _climb(s[way], float(t[middle]), steps)
    s_middle, t_middle = min(max(float(s[middle]), 1.0), 254.0), float(t[middle])
    dark, ratio = _FEATURES * s_middle, t_middle / s_middle
    if dark < s[0]:  # brows, lashes and pupils are darker than any skin: they keep their distance to it in light
        s, t = np.insert(s, 0, dark), np.insert(t, 0, dark * ratio * depth)
        t = np.maximum.accumulate(t)
    kept = (s > 0.0) & (s < 255.0) & (t > 0.0) & (t < 255.0)
    levels = np.arange(256.0)
    if not kept.any():
        return levels
    s, t = s[kept], t[kept]
    white = min(255.0, t[-1] + _TO_WHITE * (255.0 - s[-1]))
    table = np.interp(levels, np.concatenate([[0.0], s, [255.0]]), np.concatenate([[0.0], t, [white]]))
    smooth = _box(_box(table))
    # the corner at the median is rounded as well: the curve is led back through it, its ends stay
    led = np.minimum(levels / s_middle, (255.0 - levels) / (255.0 - s_middle))
    return smooth + (t_middle - float(np.interp(s_middle, levels, smooth))) * led


def steeper(tone: Doubles, middle: float, crisp: float) -> Doubles:
    """T (256,) made steeper below the skin's middle luma, where it lifts shadows.

    There its slope is less than T/Y, by which shade, brows and stubble would darken in their own light: it becomes
    T'^(1 − p) (T/Y)^p, though nothing gets darker than by the gain at the middle.  crisp: p, in [0, 1].
    """
    levels = np.arange(256.0)
    rise = np.gradient(tone)
    ratio = np.maximum(tone, 1.0) / np.maximum(levels, 1.0)
    steep = np.maximum(rise, 0.0) ** (1.0 - crisp) * ratio**crisp
    share = np.clip((middle - levels) / (_MIDDLE * middle), 0.0, 1.0)
    more = share * np.maximum(steep - rise, 0.0)
    darker = (np.cumsum(more) - 0.5 * more) - more.sum()
    by_middle = levels * float(np.interp(middle, levels, tone)) / middle
    return np.asarray(np.maximum(tone + darker, np.minimum(tone, by_middle)))


def below_white(tone: Doubles, own: UsualChroma, goal: UsualChroma) -> Doubles:
    """T (256,) darkened where a channel of the brightest skin that it makes gets near to white.

    There red would be cut off while luma still rises: highlights would turn yellow, then flat. Bending the curve would
    flatten them as well, so all of the skin is made a little darker instead, but no darker than it is in the clip.
    own, goal: see `SkinMap`.
    """
    levels = np.arange(256.0)
    high = luma = np.maximum(np.interp([own.brightest], levels, tone), 1.0)
    for _ in range(_ROUNDS):
        luma = luma * min(1.0, HIGHLIGHT / float((luma + goal.at(luma).max(axis=1).clip(0.0))[0]))
    return np.asarray(np.maximum(tone * (luma / high), np.minimum(tone, levels)))


def _climb(s: Doubles, start: float, slopes: Doubles) -> Doubles:
    """T at lumas `s` (n,) from the first on, where it is `start`, by slopes (n - 1,) of bounded gain."""
    t = [start]
    for here, there, slope in zip(s, s[1:], slopes, strict=False):
        same_light = t[-1] / max(here, 1.0)
        least = _GAINS[0] * same_light if there < here else 0.0  # what gets near to white has no room for shading
        t.append(t[-1] + (there - here) * float(np.clip(slope, least, _GAINS[1] * same_light)))
    return np.array(t)


def _box(table: Doubles) -> Doubles:
    """A table (256,) averaged over a box, continued through both ends by point reflection: black stays black."""
    half = _SMOOTH_LEVELS // 2
    padded = np.concatenate([-table[half:0:-1], table, 2 * table[-1] - table[-2 : -2 - half : -1]])
    return np.asarray(np.convolve(padded, np.full(_SMOOTH_LEVELS, 1.0 / _SMOOTH_LEVELS), mode="valid"))


@dataclass(frozen=True, eq=False)
class SkinMap:
    """The map F of a skin's colours to another's.

    tone: (256,) T;  own, goal: the usual chroma before and after;  spread: k for single pixels;  broad: k for patches
    that are no finer than the curves, at most `spread`;  alike: r of skin that is least like the rest, see
    `pvg.rendering.tinge`;  moved: how far F takes the skin from what it was, 1 where it looks like another's.
    """

    tone: Doubles
    own: UsualChroma
    goal: UsualChroma
    spread: float
    broad: float
    alike: float
    moved: float

    @classmethod
    def between(
        cls,
        skin: Floats,
        moved: Doubles,
        depth: float = 1.0,
        crisp: float = 0.0,
        bounded: float = 0.0,
    ) -> SkinMap:
        """F for open-skin colours `skin` (n, 3) that the transport moved to `moved` (n, 3), 0-255 RGB.

        depth: of features, see `tone_curve`;  crisp: of shade, see `steeper`;  bounded: in [0, 1], how far highlights
        are held below white, see `below_white`.
        """
        source, target = to_opponent(skin), to_opponent(moved)
        own, goal = UsualChroma.of(source), UsualChroma.of(target)
        around, wanted = source[:, 1:] - own.at(source[:, 0]), target[:, 1:] - goal.at(target[:, 0])
        spread = np.sqrt(((wanted**2).sum(axis=1).mean() + 1.0) / ((around**2).sum(axis=1).mean() + 1.0))
        chroma = [float(np.hypot(*one[:, 1:].mean(axis=0))) + _LEAST_CHROMA for one in (target, source)]
        middle = max(float(np.median(source[:, 0])), 1.0)
        tone = steeper(tone_curve(source[:, 0], target[:, 0], depth), min(middle, own.middle), crisp)
        tone = tone + bounded * (below_white(tone, own, goal) - tone)
        brighter = float(np.interp(middle, np.arange(256.0), tone)) / middle
        largest = min(1.0, brighter, chroma[0] / chroma[1])
        lumas = np.array([middle, middle * brighter])
        shift = (goal.at(lumas[1:])[0] - own.at(lumas[:1])[0] * brighter) / max(lumas[1], 1.0)
        other = min(1.0, float(np.hypot(*shift)) / _OTHER)
        far = min(1.0, other + abs(brighter - 1.0) / _OTHER_LIGHT)
        k = min(max(float(spread), _LEAST_SPREAD), max(largest * (1.0 - _OTHER_HUE * other), _FLATTEST))
        alike = float(np.quantile(own.likeness(source), _LEAST_ALIKE))
        return cls(tone, own, goal, k, k * (1.0 - _OTHER_HUE_BROAD * other), alike, far)

    def __call__(self, colors: Floats) -> Doubles:
        """Map (n, 3) colours, 0-255 RGB, with k for single pixels; the result may leave that range.

        What shines brighter than white, in HDR and camera logarithms, gains what white does.
        """
        opponent = to_opponent(colors)
        luma = self._toned(opponent[:, 0])
        chroma = self.goal.at(luma) + self.spread * (opponent[:, 1:] - self.own.at(opponent[:, 0]))
        return to_rgb(np.column_stack([luma, chroma]))

    def at_patches(self, colors: Floats) -> Doubles:
        """Map (n, 3) colours, 0-255 RGB, of patches that are no finer than the curves, with k of `broad`.

        Blood and rouge redden a skin by the green light that they take, and leave its red: luma lacks what R − Y has
        beyond the usual. What a patch loses of that makes it lighter, or a flushed cheek would become a grey smudge.
        """
        opponent = to_opponent(colors)
        beyond = opponent[:, 1:] - self.own.at(opponent[:, 0])
        lost = (1.0 - self.broad) * np.maximum(beyond[:, 1], 0.0)
        luma = self._toned(opponent[:, 0])
        luma *= 1.0 + lost / np.maximum(opponent[:, 0], 1.0)
        return to_rgb(np.column_stack([luma, self.goal.at(luma) + self.broad * beyond]))

    def _toned(self, luma: Doubles) -> Doubles:
        """T of lumas (n,)."""
        return np.asarray(np.interp(luma, np.arange(256.0), self.tone) + np.maximum(luma - 255.0, 0.0))

    @property
    def beside(self) -> Doubles:
        """(256,) the tone curve of skin beside the face, see `_shifted`."""
        return self._shifted(_SHADE)

    @property
    def ears(self) -> Doubles:
        """(256,) the tone curve of ears, which differs from `beside` in deep shade."""
        return self._shifted(_EAR_SHADE)

    def _shifted(self, shade: float) -> Doubles:
        """A tone curve (256,) that makes skin as much brighter or darker as the middle of the face's skin.

        shade: of the middle luma; what is darker goes through black.

        An ear or a neck is lit otherwise than the face, and keeps its difference to it. What is brighter than the
        middle comes no nearer to white than in proportion to how near it was. Deep shade goes through black, or along
        the face's own curve where that is brighter, as where a look makes skin darker than half.
        """
        levels, middle = np.arange(256.0), self.own.middle
        bright = float(np.interp(middle, levels, self.tone))
        shifted = levels + (bright - middle) * np.minimum(1.0, levels / (shade * middle))
        to_white = bright + (levels - middle) * (255.0 - bright) / (255.0 - middle)
        shifted = np.where(levels > middle, np.minimum(shifted, to_white), shifted)
        return np.asarray(np.where(levels < middle, np.maximum(shifted, self.tone), shifted))

    def slopes(self, colors: Floats) -> Floats:
        """F's slope in luma and in chroma (n, 2) at colours (n, 3), one for all of the face.

        T' alone is flat where a dim face is made bright, T/Y alone flat where a pale face is made dark: their geometric
        mean, T' over the whole range of the skin. Chroma's is k.
        """
        low, middle, high = self.own.low, self.own.middle, self.own.brightest
        ends = np.interp([low, middle, high], np.arange(256.0), self.tone)
        rise = (ends[2] - ends[0] + _LEAST_STEP) / (high - low + _LEAST_STEP)
        slope = np.clip(np.sqrt(rise * ends[1] / middle), *_SLOPE_RANGE)
        return np.tile(np.array([slope, self.spread], np.float32), (len(colors), 1))
