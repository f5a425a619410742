"""How much of a reference's complexion a clip's scene bears.

Two pictures differ in exposure and in the colour of their light as much as their people do. Taken wholly, the skin of
a bright picture glows in a dark scene like a lamp, that of a dark one is a mask of mud in a bright room, and what is
beige in neutral light is lilac beside yellow walls. Small differences are of people and are taken as they are, large
ones are of scenes and are taken in part: with d the logarithm of the ratio of the lumas and v the difference of
chroma over luma,

    d' = d / (1 + s |d| / d0)        v' = v / (1 + s |v| / v0)

of which s is asked for and d0, v0 are what a scene bears: what lies as far away comes half as near at s = 1.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.looks.tone import to_opponent, to_rgb

SCENE = 1.0  # default of s [by blind choice]
_BRIGHTNESS = 0.8  # d0, natural logarithm of luma [by blind choice]
_HUE = 0.5  # v0, chroma over luma [by blind choice]


def in_scene(reference: Floats, own: Floats, share: float) -> Floats:
    """The colours (m, 3) of a reference's open skin as the scene of the clip's skin `own` (n, 3) bears them.

    Both 0-255 RGB and not empty;  share: s, in [0, 1], 0 leaves the reference as it is. All of the reference's colours
    go the way of their median, so that shading, blush and freckles stay.
    """
    goal, start = (to_opponent(np.median(colors, axis=0)[None].astype(np.float64))[0] for colors in (reference, own))
    if share == 0.0 or min(goal[0], start[0]) < 1.0:
        return reference
    brighter = float(np.log(goal[0] / start[0]))
    richer = goal[1:] / goal[0] - start[1:] / start[0]
    gain = np.exp(brighter / (1.0 + share * abs(brighter) / _BRIGHTNESS) - brighter)
    kept = 1.0 / (1.0 + share * float(np.hypot(*richer)) / _HUE)
    luma, chroma = np.split(to_opponent(reference), [1], axis=1)
    chroma = chroma - (1.0 - kept) * richer * luma
    return np.asarray(np.clip(to_rgb(gain * np.hstack([luma, chroma])), 0.0, 255.0), np.float32)
