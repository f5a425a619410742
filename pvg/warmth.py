"""Warmth: how much of the skin's hue is in what is around the people of a picture.

A room in lamp light, an evening, a film's orange grade, a wall of wood: beside all of them skin that is right in
daylight looks grey. Light and paint are not told apart, for to the eye they are the same surroundings.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Bytes, Doubles, ramp
from pvg.picture import LUMA

MOST_WARMTH = 100  # of 100 of luma [by eye]: as much chroma as light has whose blue is gone
_SKIN_HUE = np.array([-0.77, 0.63])  # B − Y and R − Y of skin, of length 1 [measured: means of 98 pictures]
_HUE = (1.0, 0.6)  # of chroma along that, which lies across it, from none of it to all [by eye]: no leaves, no sky
_LUMA = (24.0, 245.0)  # levels, between which a cell's chroma says something [by eye]
_NOBODY = 64  # of 255 of the person mask [by eye]: less is nobody
_LEAST = 0.05  # of the cells [by eye]: fewer are no surroundings


def warmth_of(rgb: Bytes, person: Bytes) -> int:
    """Chroma over luma that a small picture has off its people, along the skin's hue, in 100: up to `MOST_WARMTH`.

    The mean of all light there is and the median of its cells, half and half: a lamp is not all of a room, and a room
    has its lamp.  rgb: (h, w, 3), without haze;  person: (h, w), 255 on people.
    """
    colors = rgb[person < _NOBODY].astype(np.float64)
    luma = colors @ LUMA
    tells = (luma > _LUMA[0]) & (luma < _LUMA[1])
    if tells.sum() < max(_LEAST * person.size, 1.0):
        return 0
    luma = luma[tells]
    chroma = colors[tells][:, [2, 0]] - luma[:, None]
    around: Doubles = (chroma.sum(axis=0) / luma.sum() + np.median(chroma / luma[:, None], axis=0)) / 2
    along, across = float(around @ _SKIN_HUE), abs(float(_SKIN_HUE[0] * around[1] - _SKIN_HUE[1] * around[0]))
    if along <= 0.0:
        return 0
    return int(np.clip(round(100.0 * along * float(ramp(across / along, *_HUE))), 0, MOST_WARMTH))
