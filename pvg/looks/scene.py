"""How much of a reference's complexion a clip's scene bears.

Two pictures differ in exposure and in the colour of their light as much as their people do. Taken wholly, the skin of
a bright picture glows in a dark scene like a lamp, that of a dark one is a mask of mud in a bright room, and what is
beige in neutral light is lilac beside yellow walls. Small differences are of people and are taken as they are, large
ones are of scenes too and are taken in part: with x a difference, the logarithm of the ratio of the lumas or that of
chroma over luma, and k what a scene bears,

    x' = x   up to k        x' = k + (m − k) (1 − exp(−(x − k) / (m − k)))   beyond, of brightness
                            x' = k (1 + ln(x / k))                           beyond, of hue

A face that is lit as its scene is has an end to how bright or dark it may be, m; what a person's hue may be has none
that a scene knows, see `pvg.looks.complexion`.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.looks.tone import to_opponent, to_rgb

SCENE = 1.0  # default of the share [by blind choice]
# k and m of the natural logarithm of luma, where the reference is brighter and where it is darker [by blind choice]
_BRIGHTER, _DARKER = (0.25, 0.40), (0.20, 0.26)
_HUE = 0.12  # k of chroma over luma [by blind choice]


def in_scene(reference: Floats, own: Floats, share: float) -> Floats:
    """The colours (m, 3) of a reference's open skin as the scene of the clip's skin `own` (n, 3) bears them.

    Both 0-255 RGB and not empty;  share: in [0, 1], of what the scene does not bear, how much is left away; 0 takes the
    reference as it is. All of its colours go the way of their median, so that shading, blush and freckles stay.
    """
    if share == 0.0:
        return reference
    goal, start = (to_opponent(np.median(colors, axis=0)[None].astype(np.float64))[0] for colors in (reference, own))
    if min(goal[0], start[0]) < 1.0:
        return reference
    brighter = float(np.log(goal[0] / start[0]))
    richer = goal[1:] / goal[0] - start[1:] / start[0]
    far, off = abs(brighter), float(np.hypot(*richer))
    gain = np.exp(-share * np.sign(brighter) * (far - _bright(far, *(_BRIGHTER if brighter > 0 else _DARKER))))
    kept = 1.0 - share * (1.0 - _hue(off / _HUE))
    luma, chroma = np.split(to_opponent(reference), [1], axis=1)
    chroma = chroma - (1.0 - kept) * richer * luma
    return np.asarray(np.clip(to_rgb(gain * np.hstack([luma, chroma])), 0.0, 255.0), np.float32)


def _bright(far: float, surely: float, most: float) -> float:
    """x' of a difference of brightness, of which a scene bears `surely` as it is and `most` at most."""
    room = most - surely
    return far if far <= surely else surely + room * (1.0 - float(np.exp((surely - far) / room)))


def _hue(far: float) -> float:
    """x' / x of a difference of hue that is so many k."""
    return 1.0 if far <= 1.0 else (1.0 + float(np.log(far))) / far
