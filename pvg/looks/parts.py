"""Part by part: skin goes to skin by one smooth map, lips take the reference's difference between lips and skin."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.asset import KeyFrame
from pvg.curves import GROUPS, table_labels
from pvg.looks.color_map import SMALLEST_GROUP, ColorMap, TransportSteps, all_colors_map
from pvg.looks.tone import SkinMap, to_opponent, to_rgb

_LIPS = table_labels().group == GROUPS.index("lips")
_LIPS_WAY = 0.75  # of the way from where the skin's map takes the lips to the reference's lips [by eye]
# what lips can be beside skin [by eye]: darker by so much of its luma, or a little lighter; B − Y and R − Y in levels
_LIPS_DARKER, _LIPS_LIGHTER = 0.35, 0.05
_LIPS_BLUE, _LIPS_RED = (-30.0, 20.0), (0.0, 60.0)
# beyond these the reference shows no lips: a beard, a shadow or an open mouth [by eye]
_SHADOW = 0.5  # of the skin's luma
_LIGHT = (1 / 1.5, 1.5)  # of the lips' own shades [by eye]
_LEAST_RED = 1.0  # levels of R − Y above the skin's


def parts_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps) -> ColorMap:
    """Skin to skin and lips to lips.

    The open skin's colours are transported, and all curves follow the smooth map F that this comes to: brows and eyes
    go as they would in another light, so that no dark brow of the reference falls on a lid. Lips go with the skin and
    most of the way to the reference's difference between lips and skin. Without enough open skin on either side the
    curves' colours stand in for it.
    """
    if min(len(key.skin), len(target.skin)) == 0:
        return all_colors_map(key, target, steps)
    skin = SkinMap.between(key.skin, steps.transport(key.skin, target.skin))
    ours, theirs = _lip_color(key), _lip_color(target)
    change = np.zeros(3)
    if ours is not None and theirs is not None:
        change = _lip_change(skin, key.skin, ours, target.skin, theirs)

    def apply(other: KeyFrame) -> tuple[Doubles, Floats]:
        moved, contrast = skin(other.colors), skin.contrast(other.colors)
        middle = _lip_color(other)
        if middle is not None and change.any():
            goal = to_opponent(skin(middle[None])) + change
            # their own shades, in another light
            light = np.clip(goal[0, 0] / max(to_opponent(middle[None])[0, 0], 1.0), *_LIGHT)
            moved[_LIPS] = to_rgb(goal) + light * (other.colors[_LIPS] - middle)
        return moved, contrast

    return apply


def _lip_change(skin: SkinMap, own_skin: Floats, lips: Floats, their_skin: Floats, their_lips: Floats) -> Doubles:
    """(3,) luma, B − Y and R − Y to add to lips that the skin's map has moved; 0 where the reference shows no lips."""
    base = to_opponent(np.median(their_skin, axis=0)[None])[0]
    wanted = to_opponent(their_lips[None])[0] - base
    if wanted[2] < _LEAST_RED or base[0] + wanted[0] < _SHADOW * base[0]:
        return np.zeros(3)
    face = to_opponent(skin(np.median(own_skin, axis=0)[None]))[0]
    wanted[0] = np.clip(wanted[0] / max(base[0], 1.0), -_LIPS_DARKER, _LIPS_LIGHTER) * face[0]
    wanted[1], wanted[2] = np.clip(wanted[1], *_LIPS_BLUE), np.clip(wanted[2], *_LIPS_RED)
    return np.asarray(_LIPS_WAY * (wanted - (to_opponent(skin(lips[None]))[0] - face)))


def _lip_color(key: KeyFrame) -> Floats | None:
    """(3,) median of the visible lip samples, None when there are too few."""
    seen = _LIPS & key.visible
    if int(seen.sum()) < SMALLEST_GROUP:
        return None
    return np.asarray(np.median(key.colors[seen], axis=0))
