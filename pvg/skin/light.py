"""How brightly a face is lit, and dim pictures brought to the light in which skin is told.

Colour distances, hair, edges and the networks know people as they are photographed: on a third of a picture's levels
a fair fringe is the skin's colour, and cloth is as grey as a hand.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.skin.parameters import SKIN_PRIOR

_LIGHT = SKIN_PRIOR.light

MID_GREY: Final = np.full(3, 128, np.float32)
"""The colour of a face of which nothing is seen, 8-bit levels."""


def face_color(rgb: Bytes, sample: Bools) -> Floats:
    """(3,) median colour of the middle of a face, RGB levels: the cells `sample` (h, w) bool of rgb (h, w, 3)."""
    if not sample.any():
        return MID_GREY
    return np.asarray(np.maximum(np.median(rgb[sample], axis=0), _LIGHT.dimmest), np.float32)


def gain_of(color: Floats) -> float:
    """What a picture is multiplied by in which a face has this colour (3,): 1 but for dim faces, and no hue changes."""
    return min(max(1.0, _LIGHT.level / float(color.max())), _LIGHT.most)


def brightened(rgb: Bytes, gain: float) -> Bytes:
    """A picture (h, w, 3) uint8 times a gain ≥ 1."""
    if gain == 1:
        return rgb
    return np.asarray(cv2.convertScaleAbs(rgb, alpha=gain), np.uint8)
