"""Highlights on a person's skin off the face: shoulders and chests in the sun, brighter and paler than the skin.

A lit place shines in the light's colour over its own: the brighter it is, the less chroma it has. So has a white shirt
beside skin. What tells them apart is the way from one to the other: a highlight goes over into the skin around it, a
shirt begins at an edge.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, smoothstep
from pvg.skin.body_colors import greyness
from pvg.skin.cleanup import goes_over, occupied
from pvg.skin.color_model import ColorScale
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.light import lab_in_light
from pvg.skin.parameters import SKIN_PRIOR

_BODY, _LIT = SKIN_PRIOR.body, SKIN_PRIOR.highlights


def fill_highlights(probability: Floats, face: Floats, seen: FaceInScene, scale: ColorScale, gain: Floats) -> None:
    """Raise the probability (h, w), in place, in parts that are skin in brighter light than is around them.

    face: (h, w) the face's matte in [0, 1];  scale: of the face's skin in the light of its key frame;
    gain: (3,) to that light.
    """
    skin = (probability > 0.5) | (face > 0.5)
    lit = ~skin & (seen.person > 255 * _LIT.person) & _bright(seen.rgb, scale, gain)
    least = _LIT.least * seen.head.size**2
    if np.count_nonzero(lit) < least:
        return
    lit[lit] = _may_be_lit(lab_in_light(seen.rgb[lit][None], gain)[0], scale)
    if np.count_nonzero(lit) < least:
        return
    cells = occupied(lit.view(np.uint8), 1)
    rgb, skin, likely = seen.rgb[cells], skin[cells], probability[cells]
    count, labels, stats, _ = cv2.connectedComponentsWithStats(lit[cells].view(np.uint8), connectivity=4)
    for part in range(1, count):
        x, y, w, h, area = (int(v) for v in stats[part])
        if area < least:
            continue
        box = slice(max(0, y - 1), y + h + 1), slice(max(0, x - 1), x + w + 1)
        inside = labels[box] == part
        if goes_over(lab_in_light(rgb[box], gain), inside, skin[box]) >= _LIT.share:
            likely[box][inside] = _LIT.probability


def _bright(rgb: Bytes, scale: ColorScale, gain: Floats) -> Bools:
    """(h, w) whether some channel is as bright as one must be at least where L is that of a highlight."""
    grey = np.array([[[min(float(scale.center[0] + _LIT.lighter * scale.spread[0]), 100.0), 0.0, 0.0]]], np.float32)
    level = 255.0 * float(cv2.cvtColor(grey, cv2.COLOR_Lab2RGB).min())
    red, green, blue = (rgb[..., k] > int(min(level / gain[k], 255.0)) for k in range(3))
    return np.asarray(red | green | blue)


def _may_be_lit(lab: Floats, scale: ColorScale) -> Bools:
    """(n,) whether colours lab (n, 3) can be the skin's in brighter light, which takes some of their chroma."""
    away = (lab[..., 0] - scale.center[0]) / scale.spread[0]
    along, across = scale.of_hue(lab)
    paled = 1 - _LIT.pales * smoothstep(away, *_LIT.pales_rise)
    along = np.where(along < 0, along * paled, along)
    squares = (along / np.where(along < 0, *_BODY.along)) ** 2 + (across / _BODY.across) ** 2
    return np.asarray((away > _LIT.lighter) & (_BODY.base - 0.5 * squares - greyness(along, scale) > 0))
