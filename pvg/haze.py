"""Haze: light that lies over a whole picture and lifts its black.

Fog, the sun in a lens and the faded look of many apps leave

    P = v + (1 − v / 255) I

of a picture I, with v levels of haze. Black hair is then a grey that is little darker than skin, and skin as pale as a
wall. So skin is told, and a face's colours are moved, without it (`without_haze`, `cleared`); what is drawn has it
again (`through_haze`), or the face would stand before the picture that it is in. How much there is the dark channel
tells [He, Sun, Tang: Single Image Haze Removal Using Dark Channel Prior, 2009]: in clear pictures some colour lacks
one of red, green and blue nearly wholly.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np

from pvg._arrays import Bytes, Doubles, Floats

Colors = TypeVar("Colors", Floats, Doubles, Floats | Doubles)

MOST_HAZE = 160  # levels of 255 [by eye]: of more nothing shows through
_DARKEST = 0.001  # of a picture's pixels [by eye]: so many are as dark as the haze lets them be
_CLEAR = 36  # levels [measured: of 30 clips and portraits 34 at most]
_SURENESS = 2  # levels of haze a level beyond that [by eye]: no jump from clear to hazy
_BLACK = 10  # levels [measured: about what those 30 have]: no haze, where there surely is some above it
_BAR = 20  # levels [by eye]: black bars are no brighter
_BAR_EDGE = 2  # rows or columns [by eye]: between bar and picture cells hold something of both, and scaling rings
_WHITE = 255


def haze_of(rgb: Bytes) -> int:
    """How many levels of a small picture (h, w, 3) are haze, 0 where it is as clear as pictures are.

    Where there is surely more than clear pictures have, none of it is spared: their black is darker than their limit.
    """
    red, green, blue = cv2.split(rgb)  # whole planes: the least of three neighbours takes fifty times as long
    dark = _without_bars(np.asarray(cv2.min(cv2.min(red, green), blue), np.uint8))
    upto = np.cumsum(np.bincount(dark.ravel(), minlength=_WHITE + 1))
    darkest = int(np.searchsorted(upto, _DARKEST * dark.size))
    return int(np.clip(min(_SURENESS * (darkest - _CLEAR), darkest - _BLACK), 0, MOST_HAZE))


def without_haze(rgb: Bytes, haze: int) -> Bytes:
    """A picture (h, w, 3) as it would be without so many levels of haze; white stays white."""
    if haze == 0:
        return rgb
    levels = np.clip(cleared(np.arange(_WHITE + 1.0), haze), 0, _WHITE)
    return np.asarray(cv2.LUT(rgb, np.rint(levels).astype(np.uint8)), np.uint8)


def shown_through(haze: int) -> float:
    """1 − v / 255: how much of a clear picture's differences so many levels of haze leave."""
    return 1.0 - haze / _WHITE


def cleared(colors: Colors, haze: int) -> Colors:
    """Colours (…, 3), 0-255 RGB, without so many levels of haze; what is darker than it is below 0."""
    return colors if haze == 0 else (colors - haze) / shown_through(haze)


def through_haze(colors: Colors, haze: int) -> Colors:
    """Clear colours (…, 3), 0-255 RGB, under so many levels of haze."""
    return colors if haze == 0 else colors * shown_through(haze) + haze


def _without_bars(dark: Bytes) -> Bytes:
    """What is left of a picture's dark channel (h, w) between black bars at its sides, all of it if nothing is."""
    for axis in (1, 0):
        seen = np.flatnonzero(dark.max(axis=axis) > _BAR)
        if len(seen) == 0:
            return dark
        first, last = int(seen[0]), int(seen[-1])
        within = np.arange(first + _BAR_EDGE * (first > 0), last + 1 - _BAR_EDGE * (last + 1 < dark.shape[1 - axis]))
        dark = np.take(dark, within if len(within) else seen, axis=1 - axis)
    return dark
