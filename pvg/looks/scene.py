"""How much of a reference's complexion a clip's scene bears.

Two pictures differ in exposure and in the colour of their light as much as their people do. Taken wholly, the skin of
a bright picture glows in a dark scene like a lamp, that of a dark one is a mask of mud in a bright room, and what is
beige in neutral light is lilac beside yellow walls. Small differences are of people and are taken as they are, large
ones are of scenes too and are taken in part: with x a difference, the logarithm of the ratio of the lumas or that of
chroma over luma, and k what a scene bears,

    x' = x   up to k        x' = k (1 + ln(x / k))   beyond

Of a difference in luma, some is told from exposure by the colour. More light makes skin brighter and leaves chroma over
luma, s, as it is; more pigment makes it darker and s larger, by about ln Y = c − 1.2 s [measured: 31 faces, slope
−1.0, correlation −0.6]. So with x the whole and p = −1.2 (s_ref − s), within 0 and x, what pigment explains, the rest
is exposure, of which a scene bears less:

    x' = p + (x − p)'
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.looks.tone import to_opponent, to_rgb

SCENE = 1.0  # default of the share [by blind choice]
_BRIGHTNESS = 0.25  # k of the natural logarithm of luma [by blind choice]
_EXPOSURE = 0.18  # k of that part of it that is light rather than pigment [by blind choice]
_PIGMENT = 1.2  # of the logarithm of luma a unit of chroma over luma [measured: see above]
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
    saturation, own_saturation = (float(np.hypot(*color[1:])) / color[0] for color in (goal, start))
    pigment = float(np.clip(_PIGMENT * (own_saturation - saturation), min(brighter, 0.0), max(brighter, 0.0)))
    borne = _borne(pigment + _borne(brighter - pigment, _EXPOSURE), _BRIGHTNESS)
    gain = np.exp(share * (borne - brighter))
    richer = goal[1:] / goal[0] - start[1:] / start[0]
    further = float(np.hypot(*richer))
    kept = 1.0 - share * (1.0 - _borne(further, _HUE) / max(further, 1e-6))
    luma, chroma = np.split(to_opponent(reference), [1], axis=1)
    chroma = chroma - (1.0 - kept) * richer * luma
    return np.asarray(np.clip(to_rgb(gain * np.hstack([luma, chroma])), 0.0, 255.0), np.float32)


def _borne(difference: float, k: float) -> float:
    """x' of a difference x."""
    far = abs(difference) / k
    return difference if far <= 1.0 else float(np.copysign(k * (1.0 + np.log(far)), difference))
