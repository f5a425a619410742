"""Part by part: skin goes to skin and lips to lips."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.asset import KeyFrame
from pvg.curves import GROUPS, table_labels
from pvg.looks.color_map import SMALLEST_GROUP, ColorMap, TransportSteps, all_colors_map
from pvg.looks.tone import ComplexionMap

_LIPS_WAY = 0.75  # of the way from where the light takes the lips to the reference's lips [by eye]
_LIPS = table_labels().group == GROUPS.index("lips")


def parts_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps) -> ColorMap:
    """Skin to skin and lips to lips.

    The open skin's colours are transported, and the curves follow what that does to a complexion: brows and eyes go
    as they would in another light, so that no dark brow of the reference falls on a lid. Lips keep their own shades
    and go most of the way to the reference's lips. Without enough open skin on either side the curves' colours stand
    in for it.
    """
    if min(len(key.skin), len(target.skin)) == 0:
        return all_colors_map(key, target, steps)
    complexion = ComplexionMap.between(key.skin, steps.transport(key.skin, target.skin))
    ours, theirs = _lip_color(key), _lip_color(target)
    if ours is None or theirs is None:
        return lambda other: complexion(other.colors)
    beside_skin = _LIPS_WAY * (theirs - complexion(ours[None])[0])

    def apply(other: KeyFrame) -> Doubles:
        moved = complexion(other.colors)
        middle = _lip_color(other)
        if middle is not None:
            goal = complexion(middle[None])[0] + beside_skin
            moved[_LIPS] = goal + complexion.brightness * (other.colors[_LIPS] - middle)
        return moved

    return apply


def _lip_color(key: KeyFrame) -> Floats | None:
    """(3,) median of the visible lip samples, None when there are too few."""
    seen = _LIPS & key.visible
    if int(seen.sum()) < SMALLEST_GROUP:
        return None
    return np.asarray(np.median(key.colors[seen], axis=0))
