"""One smooth map of colour, regressed from the transport of the open skin: tone by a curve, chroma by tone.

Transport matches extremes to extremes: between a flatly lit face and a shaded one it would turn the slightest
unevenness into blotches, and moved apart from each other the three channels stain shadows and brows. What light and
pigment do to a skin is smoother: a tone curve, and for each tone a chroma. The map F keeps just that of the transport.

    Y' = T(Y)                              T monotone, through black, rolling off to white
    c' = m'(T(Y)) + k (c − m(Y))           m, m': the chroma that is usual at a luma, before and after

Brows, sockets and the shadow of a fringe lie on the same curve as the skin, so they keep their hue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.tone import LEAST_STEP, below_white, steeper, tone_curve
from pvg.looks.usual_chroma import UsualChroma

# of k, the ratio of the spreads of chroma at a tone: what differs from the usual chroma dims and greys with the skin
# and never grows, or a flushed nose, freckles and light of two colours turn into orange and green patches [by eye]
_LEAST_SPREAD = 0.5
_FLATTEST = 0.4  # of what may be the most of k
# what is redder or yellower than the rest of the skin looks like a stain on skin of another hue: the most that k may be
# falls by that share where the saturation, levels of chroma a level of luma, moves by so much [by eye]
_OTHER_HUE, _OTHER = 0.4, 0.08
_OTHER_HUE_BROAD = 0.6  # the same of k at the curves, where it tells of patches: a flushed nose or chin [by eye]
# what gets brighter or darker by half shows it as much as what changes its hue by `_OTHER` [by eye]
_OTHER_LIGHT = 0.5
_SLOPE_RANGE = (0.6, 2.0)  # of F in luma as a whole [by eye]
# of the middle luma: skin beside the face that is darker than this goes through black [by blind choice: 0.4 rather than
# 0.8 for necks and arms in even shade, 0.8 rather than 0.4 for a shoulder that is modelled by it], and ears
_SHADE, _EAR_SHADE = 0.55, 0.35
_LEAST_CHROMA = 4.0  # levels added to both sides of the ratio of chroma, so that grey skin does not explode
_LEAST_ALIKE = 0.05  # quantile


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
        middle = max(float(np.median(source[:, 0])), 1.0)
        tone = steeper(tone_curve(source[:, 0], target[:, 0], depth), min(middle, own.middle), crisp)
        tone = tone + bounded * (below_white(tone, own, goal) - tone)
        brighter = float(np.interp(middle, np.arange(256.0), tone)) / middle
        hue = _other_hue(own, goal, middle, brighter)
        most = min(1.0, brighter, _ratio_of_chroma(source, target)) * (1.0 - _OTHER_HUE * hue)
        spread = min(max(_ratio_of_spreads(source, target, own, goal), _LEAST_SPREAD), max(most, _FLATTEST))
        return cls(
            tone=tone,
            own=own,
            goal=goal,
            spread=spread,
            broad=spread * (1.0 - _OTHER_HUE_BROAD * hue),
            alike=float(np.quantile(own.likeness(source), _LEAST_ALIKE)),
            moved=min(1.0, hue + abs(brighter - 1.0) / _OTHER_LIGHT),
        )

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

        An ear or a neck is lit otherwise than the face, and keeps its difference to it. What is brighter than the
        middle comes no nearer to white than in proportion to how near it was. Deep shade goes through black, or along
        the face's own curve where that is brighter, as where a look makes skin darker than half.
        shade: of the middle luma; what is darker is deep shade.
        """
        levels, middle = np.arange(256.0), self.own.middle
        bright = float(np.interp(middle, levels, self.tone))
        shifted = levels + (bright - middle) * np.minimum(1.0, levels / (shade * middle))
        # the middle of burnt-out skin may lie at white
        to_white = bright + (levels - middle) * (255.0 - bright) / max(255.0 - middle, 1e-6)
        shifted = np.where(levels > middle, np.minimum(shifted, to_white), shifted)
        return np.asarray(np.where(levels < middle, np.maximum(shifted, self.tone), shifted))

    def slopes(self, colors: Floats) -> Floats:
        """F's slope in luma and in chroma (n, 2) at colours (n, 3), one for all of the face.

        T' alone is flat where a dim face is made bright, T/Y alone flat where a pale face is made dark: their geometric
        mean, T' over the whole range of the skin. Chroma's is k.
        """
        low, middle, high = self.own.low, self.own.middle, self.own.brightest
        ends = np.interp([low, middle, high], np.arange(256.0), self.tone)
        rise = (ends[2] - ends[0] + LEAST_STEP) / (high - low + LEAST_STEP)
        slope = np.clip(np.sqrt(rise * ends[1] / middle), *_SLOPE_RANGE)
        return np.tile(np.array([slope, self.spread], np.float32), (len(colors), 1))


def _ratio_of_spreads(source: Doubles, target: Doubles, own: UsualChroma, goal: UsualChroma) -> float:
    """How far chroma lies around the usual one at its luma after the transport, over how far it does before.

    source, target: (n, 3) luma and chroma;  own, goal: the usual chroma of either.
    """
    before, after = (
        float(((one[:, 1:] - usual.at(one[:, 0])) ** 2).sum(axis=1).mean()) + 1.0
        for one, usual in ((source, own), (target, goal))
    )
    return float(np.sqrt(after / before))


def _ratio_of_chroma(source: Doubles, target: Doubles) -> float:
    """The mean chroma of luma and chroma (n, 3) after the transport over that before."""
    before, after = (float(np.hypot(*one[:, 1:].mean(axis=0))) + _LEAST_CHROMA for one in (source, target))
    return after / before


def _other_hue(own: UsualChroma, goal: UsualChroma, middle: float, brighter: float) -> float:
    """How far a skin gets another hue, in [0, 1].

    own, goal: the usual chroma before and after;  middle: its middle luma;  brighter: what that is multiplied by.
    """
    lumas = np.array([middle, middle * brighter])
    shift = (goal.at(lumas[1:])[0] - own.at(lumas[:1])[0] * brighter) / max(lumas[1], 1.0)
    return min(1.0, float(np.hypot(*shift)) / _OTHER)
