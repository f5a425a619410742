"""Lips apart from their surroundings: the membrane carries the skin's change across them, their own is added to it.

A curve's colours reach as far as the next curve. What F does to lips differs from what it does to skin, so a value of
their own at their curves would leak into the skin beside them, a cloud around the mouth. Their curves take the change
of the skin around them instead, and what is then missing of F's is added within the lips, see `pvg.rendering.makeup`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.face import PARTS
from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.skin_map import SkinMap

_AROUND: Mapping[str, tuple[str, ...]] = {"lips": ("upper_lip", "chin")}  # curves of the skin beside each part


def parts_apart(key: KeyFrame, skin: SkinMap, moved: Doubles, contrast: float) -> tuple[Doubles, Floats]:
    """New boundary colours without those of parts, and what each part lacks then.

    moved: (S, 3) F of the key frame's colours;  contrast: λ, by which chroma is drawn: the skin's change of it is what
    the membrane carries, g' − λg. Luma keeps F's slope, or steep contrast would make a dark ring.
    Returns them anew, and (P, 3) luma, B − Y and R − Y in levels that parts are to gain, zero where a part is not seen.
    """
    lacks = np.zeros((len(PARTS), 3), np.float32)
    own, goal = to_opponent(key.parts), to_opponent(skin(key.parts))
    new = moved.copy()
    for part, (on, around) in _places().items():
        p, seen = PARTS.index(part), around[key.visible[around]]
        if np.isnan(own[p, 0]) or not len(seen):
            continue
        slope = np.array([skin.slopes(key.colors[seen])[:, 0].mean(dtype=np.float64), contrast, contrast])
        shift = (to_opponent(moved[seen]) - slope * to_opponent(key.colors[seen])).mean(axis=0)
        new[on] = to_rgb(slope * to_opponent(key.colors[on]) + shift)
        lacks[p] = goal[p] - (slope * own[p] + shift)
    return new, lacks


@cache
def _places() -> dict[str, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Of each part apart the samples of the table on it, and those of the skin beside it."""
    labels = table_labels()
    return {
        part: (np.flatnonzero(labels.on_group(part)), np.flatnonzero(labels.on_curves(*around)))
        for part, around in _AROUND.items()
    }
