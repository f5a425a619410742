"""From where to where a colour's likeness to skin, r of `pvg.rendering.tinge`, tells skin from what is grey.

Skin in the shade of a sky, or beside a window, is as grey as a collar and as blue as black hair. That a face has such
light is told by its own skin, a part of which is then less like the rest than it is in usual light. There what is as
dark as shade is taken for skin, however grey it is; black hair is darker, white hair, collars and glare are brighter.

Where glare lies on skin a colour is a mixture of both, r of skin and 1 − r of light (the dichromatic model, Shafer
1985), and takes about that share of what skin takes: told from grey by a step, a highlight would be cut out of it.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Doubles, ramp

_USUAL = (0.2, 0.6)  # of r [by eye]
_SHADE = (-0.6, 0.0)  # of r in shade of another hue: blue as a sky, and what it makes grey [by eye]
# by r of the skin that is least like the rest: from where on no shade is of another hue, and down to where it is
# [measured: 0.61 to 0.88 in 29 portraits and clips, 0.49 under a blue sky and 0.51 beside a window]
_ANOTHER_HUE = (0.7, 0.5)
# of the skin's middle luma, from hair to shade, where there is no beard and among one, and from glare to it [by eye]
_HAIR, _BEARD, _GLARE = (0.5, 0.7), (0.75, 0.95), (1.4, 1.15)
_MIXED = (0.12, 1.0)  # of r, where glare lies on skin [by eye: from 0 on white hair and collars are tinted]
_LIT = (1.15, 1.5)  # of the skin's middle luma, where that begins [by eye]


def told_from_grey(alike: float, of_middle: Doubles, beard: float) -> Doubles:
    """(2, n) r up to which a colour is grey, and from which on it is skin.

    alike: r of the skin that is least like the rest;  of_middle: (n,) the colour's luma over the skin's middle luma;
    beard: in [0, 1], how surely there is one.
    """
    usual, mixed = np.array(_USUAL), np.array(_MIXED)
    bare, bearded = (ramp(of_middle, *hair) for hair in (_HAIR, _BEARD))
    shade = ramp(alike, *_ANOTHER_HUE) * (bare + beard * (bearded - bare)) * ramp(of_middle, *_GLARE)
    told = usual[:, None] + shade * (np.array(_SHADE) - usual)[:, None]
    return np.asarray(told + ramp(of_middle, *_LIT) * (mixed[:, None] - told))
