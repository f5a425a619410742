"""The tone curve T of a skin's map F (`pvg.looks.skin_map`): luma to luma, through black, rolling off to white.

It is taken from the quantiles of two skins, with slopes that are bounded: transport matches extremes to extremes, and
would turn the slightest unevenness of a flatly lit face into blotches.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Doubles
from pvg.looks.usual_chroma import SEEN, UsualChroma

CRISP = 0.8
"""p of `steeper` where T takes the place of λ. A face made bright by lifted shadows is flat, its brows and beard milky,
its neck bright [by blind choice: 0.8 rather than 0.4 or 0]."""
HIGHLIGHT = 243.0
"""Level of the brightest channel in the brightest of the skin, at most."""
LEAST_STEP = 0.25
"""Levels added to both sides of a slope, so that skin of one tone has one."""

_QUANTILES = (SEEN[0], 0.10, 0.25, 0.50, 0.75, 0.90, SEEN[1])
# the least and the most of a slope over T/Y, the slope of the same skin in more or less light: what a reference may
# take of the shading that is there [by eye], and what it may add, or it is soot on a cheek [by blind choice: 1.2 rather
# than 1 or 1.5]
_GAINS = (0.55, 1.2)
_FEATURES = 0.45  # of the skin's median luma, below which what is seen in a face is no skin [by eye]
_EVEN = 0.35  # power of the whole curve's slope in each, against blotches where one stretch alone is steep [by eye]
_TO_WHITE = 1.8  # slope above the brightest skin, at most: burnt-out skin gets no whiter than the rest [by eye]
_SMOOTH_LEVELS = 25  # width of the boxes, two of them, that rounds the tone curve's corners
_MIDDLE = 0.1  # of the middle luma: over which a curve gets steeper below it
_ROUNDS = 4  # in which the luma of `HIGHLIGHT` is found: chroma changes with luma


def tone_curve(source: Doubles, target: Doubles, depth: float = 1.0) -> Doubles:
    """T as a table (256,): luma of `source` (n,) to that of `target` (m,), quantile by quantile, slopes bounded.

    depth: in (0, 1], what the luma of features, darker than any skin, is multiplied by besides. Where either is wholly
    black T is the identity.
    """
    s, t = np.quantile(source, _QUANTILES), np.quantile(target, _QUANTILES)
    middle = len(s) // 2
    each = (np.diff(t) + LEAST_STEP) / (np.diff(s) + LEAST_STEP)
    whole = (t[-1] - t[0] + LEAST_STEP) / (s[-1] - s[0] + LEAST_STEP)
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
    back = smooth + (t_middle - float(np.interp(s_middle, levels, smooth))) * led
    # led by much it would pass its end and fall again
    return np.asarray(np.minimum(np.maximum.accumulate(back), back[-1]))


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
    own, goal: the usual chroma before and after F.
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
