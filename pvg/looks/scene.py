"""Limits how far the reference's skin colour may differ from what looks plausible in the clip.

Two pictures differ in exposure and in the colour of their light as much as their people do. Taken wholly, the skin of
a bright picture glows in a dark scene like a lamp, that of a dark one is a mask of mud in a bright room, and what is
beige in neutral light is lilac beside yellow walls. Small differences are of people and are taken as they are, large
ones are of scenes too and are taken in part: with x a difference, the logarithm of the ratio of the lumas or that of
chroma over luma, and k what a scene bears,

    x' = x   up to k        x' = k (1 + ln(x / k))   beyond

Where the reference is darker there is an end to it, m: a face that is lit as its bright scene is cannot be dark at
will. So there is where its skin has less chroma: rich skin in a warm room, made pale, is grey there.

    x' = x   up to k        x' = k + (m − k) (1 − exp(−(x − k) / (m − k)))   beyond

As far as a scene does not bear another chroma, bright skin pales as it does in the clip: in a clip whose highlights
burn out a reference's bright skin, with the chroma that the clip's has in its middle, would be orange around them.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Doubles, Floats, ramp
from pvg.looks.opponent import to_opponent, to_rgb

SCENE = 1.0  # default of the share [by blind choice]
# k of the natural logarithm of luma where the reference is brighter [between 0.17 and 0.21, which blind choices gave]
_BRIGHTER = 0.19
_DARKER = (0.12, 0.16)  # k and m, where it is darker [by blind choice]
_HUE = 0.12  # k of chroma over luma [by blind choice]
_AS_RICH = (1.15, 0.85)  # of its own chroma over luma, from which to which a reference's counts as less, a line between
_POORER = (0.08, 0.14)  # k and m, where the reference's skin has less of it [by blind choice]
_BRIGHT = 0.85  # quantile of a skin's luma, from which on it is bright [by eye]
_PALES = 0.6  # of how much more the clip's skin pales there than the reference's [by blind choice: rather than 0 or 1]


def in_scene(reference: Floats, own: Floats, share: float) -> Floats:
    """The colours (m, 3) of a reference's open skin as the scene of the clip's skin `own` (n, 3) bears them.

    Both 0-255 RGB and not empty;  share: in [0, 1], how much of what the scene does not bear is left out; 0 takes the
    reference as it is. All of its colours are moved as their median is, so that shading, blush and freckles stay.
    """
    if share == 0.0:
        return reference
    goal, start = (to_opponent(np.median(colors, axis=0)[None].astype(np.float64))[0] for colors in (reference, own))
    if min(goal[0], start[0]) < 1.0:
        return reference
    brighter = float(np.log(goal[0] / start[0]))
    richer = goal[1:] / goal[0] - start[1:] / start[0]
    far, off = abs(brighter), float(np.hypot(*richer))
    rich, own_rich = (float(np.hypot(*one[1:]) / one[0]) for one in (goal, start))
    borne = far * _kept(far / _BRIGHTER) if brighter > 0.0 else _ending(far, *_DARKER)
    gain = np.exp(-share * np.sign(brighter) * (far - borne))
    poorer = ramp(rich / max(own_rich, 1e-6), *_AS_RICH)
    hue = poorer * _ending(off, *_POORER) + (1.0 - poorer) * off * _kept(off / _HUE)
    kept = 1.0 - share * (1.0 - hue / off) if off > 0.0 else 1.0
    colors = to_opponent(reference)
    (bright, pale), (_, own_pale) = _bright(colors), _bright(to_opponent(own))
    pales = pale - own_pale - richer
    luma, chroma = np.split(colors, [1], axis=1)
    rise = _PALES * ramp(luma, goal[0], max(bright, goal[0] + 1.0))
    chroma = chroma - (1.0 - kept) * (richer + rise * pales) * luma
    return np.asarray(np.clip(to_rgb(gain * np.hstack([luma, chroma])), 0.0, 255.0), np.float32)


def _bright(colors: Doubles) -> tuple[float, Doubles]:
    """Luma and (2,) chroma over luma of the bright part of colours (n, 3) of `to_opponent`."""
    luma = colors[:, 0]
    bright = colors[luma >= np.quantile(luma, _BRIGHT)]
    return float(np.median(bright[:, 0])), np.median(bright[:, 1:] / np.maximum(bright[:, :1], 1.0), axis=0)


def _kept(far: float) -> float:
    """x' / x of a difference that is so many k."""
    return 1.0 if far <= 1.0 else (1.0 + float(np.log(far))) / far


def _ending(far: float, surely: float, most: float) -> float:
    """x' of a difference of which a scene bears `surely` as it is and `most` at most."""
    room = most - surely
    return far if far <= surely else surely + room * (1.0 - float(np.exp((surely - far) / room)))
