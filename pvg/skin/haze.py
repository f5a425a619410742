"""Haze: light that lies over a whole picture and lifts its black.

Fog, the sun in a lens and the faded look of many apps leave (1 − v / 255) I + v of a picture I. Black hair is then a
grey one of little more than skin's darkness, and no colour is what it is in the light in which skin is told. How much
lies there is told by the dark channel [He, Sun, Tang: Single Image Haze Removal Using Dark Channel Prior, 2009]: in
clear pictures some colour lacks one of red, green and blue nearly wholly.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bytes
from pvg.skin.parameters import SKIN_PRIOR

_HAZE = SKIN_PRIOR.haze
_WHITE = 255


def haze_of(rgb: Bytes) -> int:
    """How many levels of a small picture (h, w, 3) are haze, 0 where it is as clear as pictures are.

    Where there is surely more than clear pictures have, none of it is spared: their black is darker than their limit.
    """
    dark = _without_bars(np.asarray(rgb.min(axis=2), np.uint8))
    upto = np.cumsum(np.bincount(dark.ravel(), minlength=_WHITE + 1))
    darkest = int(np.searchsorted(upto, _HAZE.darkest * dark.size))
    sure = _HAZE.sureness * (darkest - _HAZE.clear)
    return int(np.clip(min(sure, darkest - _HAZE.black), 0, _HAZE.most))


def without_haze(rgb: Bytes, haze: int) -> Bytes:
    """A picture (h, w, 3) as it would be without so many levels of haze; white stays white."""
    if haze == 0:
        return rgb
    clear = np.clip((np.arange(_WHITE + 1) - haze) * (_WHITE / (_WHITE - haze)), 0, _WHITE)
    return np.asarray(cv2.LUT(rgb, np.rint(clear).astype(np.uint8)), np.uint8)


def _without_bars(dark: Bytes) -> Bytes:
    """What is left of a picture's dark channel (h, w) between black bars at its sides, all of it if nothing is."""
    for axis in (1, 0):
        seen = np.flatnonzero(dark.max(axis=axis) > _HAZE.bar)
        if len(seen) == 0:
            return dark
        dark = np.take(dark, np.arange(seen[0], seen[-1] + 1), axis=1 - axis)
    return dark
