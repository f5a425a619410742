"""The complexion that a reference gives: its open skin in its key light, as the scene bears it, within what skin is.

A picture's colours are as much its camera's and its grade's as its people's. Among its own dark curtains and blue
greys, skin of little chroma looks like skin; put into another picture it looks dead. So skin that is greyer than is
usual at its lightness gains chroma, up to what is usual; but not where the clip's own skin is just as grey: a grey film
stays grey, and a clip that is given its own colours stays as it is. Pale skin has little chroma too, yet is no grey
film: made darker, it gets the chroma of darker skin.

Skin that is richer, redder or yellower than skin is, flushed, burnt out or under an orange or a greenish lamp, turns
another face to salmon, orange or olive. Its chroma is held to what skin has and its hue turned until it is no redder
and no yellower, though never beyond the clip's own.

A clip whose own skin is yellower or greener than skin is has a cast, of its light or its grade, and skin without it
looks red or mauve there: half of the cast stays.

In warm surroundings skin of daylight looks grey, and the clip's own is rich. Three quarters of the chroma that it has
more are taken there, a fifth at most, in the hue that is given.

In a grey film or a faded picture, skin as rich as a reference's would be the only colour and look painted: it takes
only a part of the chroma that the reference's skin has beyond the clip's own.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Doubles, Floats, ramp
from pvg.looks.key_light import in_key_light
from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.scene import in_scene
from pvg.picture import median_lab

# saturation, C*/L* of CIELAB, below which skin looks grey: at L* 60, its fall a level of L*, and the most of it
# [by blind choice: less or more of it was chosen less often, at L* 60, 64, 71 and 77]
_USUAL, _FALL, _MOST = 0.36, 0.004, 0.40
# of the usual saturation. Skin with more than the first of _GREY is of no grey film, with less than the second of one
# [by eye]; of _DULL, skin with more bears rich skin, which looks painted where there is less [by blind choice]
_GREY, _DULL = (0.72, 0.55), (0.90, 0.72)
# of L*: skin that gets darker by _DARKENED takes the chroma of darker skin: all of it where it ends below the second of
# _DARK, nothing where it stays above the first [by eye: pale skin is not to be tanned]
_DARKENED, _DARK = 8.0, (66.0, 60.0)
_IN_DULL = 0.6  # of what is richer than the clip's own skin, where that is dull
_GAIN = 1.3  # of chroma, at most [by blind choice]: a grade in black and white is meant
# of 100, the warmth of surroundings from which on skin keeps chroma and in which it does so most; how much of the C*
# that the clip's skin has more, and of all at most [by blind choice; by C*/L* what is made brighter would be orange]
_WARM, _WARMER, _WARMEST = (10.0, 26.0), 0.75, 0.2
_RICHEST, _REDDEST = 32.0, 23.0  # C* and a* of CIELAB, at most [by blind choice: C* of 32 rather than 28 or any]
_YELLOWEST = np.radians(62.0)  # hue of CIELAB, at most [by eye]
_AS_RICH = 6.0  # C*, over which a clip that is as rich says how red skin may be by its hue too [by eye]
_HUELESS = (2.0, 4.0)  # C* of a clip's skin: below, its hue is chance [by eye]
# how much stays of what a clip's skin is beyond that [by blind choice: rather than none or all of it]; hues, from which
# to which none to all of it counts: light that is green itself is coloured light [by eye]
_CAST, _GREEN = 0.5, (np.radians(140.0), np.radians(100.0))
_COLOURED = np.radians(25.0)  # beyond red and yellow, over which a hue becomes that of coloured light [by eye]


def complexion(reference: Floats, own: Floats, scene: float, warmth: int = 0) -> Floats:
    """The colours (m, 3) that open skin `own` (n, 3) is to take from a `reference`'s (k, 3), 0-255 RGB, m ≤ k.

    scene: in [0, 1], how far the limits of `pvg.looks.scene` hold, and those on what is greyer, richer, redder or
    yellower than skin is;  warmth: of what is around the clip's people, see `pvg.warmth`.
    """
    if min(len(reference), len(own)) == 0:
        return reference
    # skin that is in two lights itself has shade for that of the reference
    skin = in_key_light(reference) if len(in_key_light(own)) == len(own) else reference
    skin = in_scene(skin, own, scene)
    lab, bound = median_lab(skin), median_lab(own)
    if scene > 0.0 and (held := _held(lab, bound)) is not None:
        goal = lab + scene * (held - lab)
        skin, lab = _moved(skin, lab, goal), goal
    has, least = _saturation(lab), _usual(lab) * _borne(bound, lab)
    richer = max(has - max(_saturation(bound), least), 0.0)
    borne = has - scene * _greyness(bound, *_DULL) * (1.0 - _IN_DULL) * richer
    gain = 1.0 + scene * (min(max(borne, least) / max(has, 1e-6), _GAIN) - 1.0)
    more = max(_chroma_and_hue(bound)[0] / max(gain * _chroma_and_hue(lab)[0], 1e-6) - 1.0, 0.0)
    gain *= 1.0 + scene * ramp(float(warmth), *_WARM) * min(_WARMER * more, _WARMEST)
    if gain != 1.0:
        opponent = to_opponent(skin)
        opponent[:, 1:] *= gain
        skin = np.asarray(np.clip(to_rgb(opponent), 0.0, 255.0), np.float32)
    lab = median_lab(skin)
    turn = scene * _cast(lab, bound)
    if turn == 0.0:
        return skin
    chroma, hue = _chroma_and_hue(lab)
    return _moved(skin, lab, _with_chroma_and_hue(lab, chroma, hue + turn))


def _cast(lab: Doubles, own: Doubles) -> float:
    """Radians, by which the complexion `lab` is turned to keep its part of the cast that a clip's skin `own` has."""
    chroma, hue = _chroma_and_hue(own)
    _, hue_given = _chroma_and_hue(lab)
    seen = ramp(chroma, *_HUELESS) * ramp(hue, *_GREEN) * _of_skin(hue_given)
    return float(_CAST * seen * max(hue - max(_YELLOWEST, hue_given), 0.0))


def _usual(lab: Doubles) -> float:
    """The saturation that skin of a colour's lightness has usually."""
    return min(_USUAL - _FALL * (float(lab[0]) - 60.0), _MOST)


def _borne(own: Doubles, goal: Doubles) -> float:
    """How much of the usual saturation a clip's skin `own` bears in the lightness of `goal`.

    Its own share of the usual saturation; skin that is not grey and becomes darker is allowed all of it.
    """
    has = min(_saturation(own) / _usual(own), 1.0)
    darker = ramp(float(own[0] - goal[0]), 0.0, _DARKENED) * ramp(float(goal[0]), *_DARK)
    return has + darker * (1.0 - _greyness(own, *_GREY)) * (1.0 - has)


def _greyness(own: Doubles, none: float, whole: float) -> float:
    """Rises from 0 to 1 where a clip's skin has from `none` to `whole` of the saturation that such skin usually has."""
    return ramp(_saturation(own) / _usual(own), none, whole)


def _held(lab: Doubles, own: Doubles) -> Doubles | None:
    """The complexion `lab` (3,) CIELAB held to what skin can be, or to `own` where that lies farther out.

    None when nothing is to be held. A hue that is neither red nor yellow is that of coloured light: it is meant so, and
    the farther out it lies the less is held.
    """
    chroma, hue = _chroma_and_hue(lab)
    own_chroma, own_hue = _chroma_and_hue(own)
    share = _of_skin(hue)
    if share == 0.0:
        return None
    held = min(chroma, max(_RICHEST, own_chroma))
    least = float(np.arccos(min(1.0, max(_REDDEST, float(own[1])) / max(held, 1e-6))))
    least -= ramp(own_chroma, held - _AS_RICH, held) * max(least - own_hue, 0.0)
    most = _YELLOWEST + ramp(own_chroma, *_HUELESS) * max(own_hue - _YELLOWEST, 0.0)
    turned = max(min(hue, most), least)
    if held == chroma and abs(turned - hue) < 1e-6:
        return None
    return lab + share * (_with_chroma_and_hue(lab, held, turned) - lab)


def _of_skin(hue: float) -> float:
    """1 of a hue that is red, yellow or between, 0 of one that is only of coloured light."""
    return min(ramp(hue, -_COLOURED, 0.0), ramp(hue, np.pi / 2 + _COLOURED, np.pi / 2))


def _chroma_and_hue(lab: Doubles) -> tuple[float, float]:
    """C* and the hue's angle from a* to b*, radians."""
    return float(np.hypot(*lab[1:])), float(np.arctan2(lab[2], lab[1]))


def _with_chroma_and_hue(lab: Doubles, chroma: float, hue: float) -> Doubles:
    """The colour of that C* and that hue, radians, that is as light as `lab`."""
    return np.array([lab[0], chroma * np.cos(hue), chroma * np.sin(hue)])


def _moved(skin: Floats, lab: Doubles, goal: Doubles) -> Floats:
    """Colours (n, 3) whose median is `lab` with chroma moved by what leads to `goal`, in proportion to luma.

    Black has no chroma and gets none.
    """
    before, after = (
        to_opponent(255.0 * cv2.cvtColor(one.astype(np.float32).reshape(1, 1, 3), cv2.COLOR_LAB2RGB)[0])[0]
        for one in (lab, goal)
    )
    opponent = to_opponent(skin)
    opponent[:, 1:] += (after[1:] / max(after[0], 1e-6) - before[1:] / max(before[0], 1e-6)) * opponent[:, :1]
    return np.asarray(np.clip(to_rgb(opponent), 0.0, 255.0), np.float32)


def _saturation(lab: Doubles) -> float:
    """C*/L*."""
    return float(np.hypot(*lab[1:])) / max(float(lab[0]), 1.0)
