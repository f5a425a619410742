"""Highlights on a person's skin off the face: shoulders and chests in the sun, brighter and paler than the skin.

A lit place shines in the light's colour over its own: the brighter it is, the less chroma it has. So has a white shirt
beside skin. What tells them apart is the way from one to the other: a highlight goes over into the skin around it, a
shirt begins at an edge.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, smoothstep
from pvg.skin.cleanup import occupied
from pvg.skin.color_model import LEAST_CHROMA, ColorScale, to_skin_lab
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.parameters import SKIN_PRIOR

_BODY, _LIT = SKIN_PRIOR.body, SKIN_PRIOR.highlights
_BESIDE = np.ones((3, 3), np.uint8)


def fill_highlights(probability: Floats, face: Floats, seen: FaceInScene, scale: ColorScale, gain: Floats) -> None:
    """Raise the probability (h, w), in place, in parts that are skin in brighter light than is around them.

    face: (h, w) the face's matte in [0, 1];  scale: of the face's skin in the light of its key frame;
    gain: (3,) to that light.
    """
    skin = (probability > 0.5) | (face > 0.5)
    bright = ~skin & (seen.person > 255 * _LIT.person) & (_brightest(seen.rgb, gain) > _least_level(scale))
    rows, columns = occupied(bright.view(np.uint8), 1)
    if not bright[rows, columns].any():
        return
    rgb = np.asarray(np.clip(np.rint(seen.rgb[rows, columns] * gain), 0, 255), np.uint8)
    lab = to_skin_lab(rgb)
    lit = bright[rows, columns] & _may_be_lit(lab, scale)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(lit.view(np.uint8), connectivity=4)
    skin, likely = skin[rows, columns], probability[rows, columns]
    least = _LIT.least * seen.head.size**2
    for part in range(1, count):
        x, y, w, h, area = (int(v) for v in stats[part])
        if area < least:
            continue
        box = slice(max(0, y - 1), y + h + 1), slice(max(0, x - 1), x + w + 1)
        inside = labels[box] == part
        if _goes_over(lab[box], inside, skin[box]) >= _LIT.share:
            likely[box][inside] = _LIT.probability


def _brightest(rgb: Bytes, gain: Floats) -> Floats:
    """(h, w) float32, the greatest of the levels of colours (h, w, 3) in the key frame's light."""
    red, green, blue = (rgb[..., k] * gain[k] for k in range(3))
    return np.asarray(np.maximum(np.maximum(red, green), blue), np.float32)


def _least_level(scale: ColorScale) -> float:
    """The 8-bit level that some channel of a colour has at least whose L is that of a highlight."""
    grey = np.array([[[min(float(scale.center[0] + _LIT.lighter * scale.spread[0]), 100.0), 0.0, 0.0]]], np.float32)
    return 255.0 * float(cv2.cvtColor(grey, cv2.COLOR_Lab2RGB).min())


def _may_be_lit(lab: Floats, scale: ColorScale) -> Bools:
    """(h, w) whether colours lab (h, w, 3) can be the skin's in brighter light, which takes some of their chroma."""
    away = (lab[..., 0] - scale.center[0]) / scale.spread[0]
    along, across = scale.of_hue(lab)
    paled = 1 - _LIT.pales * smoothstep(away, *_LIT.pales_rise)
    along = np.where(along < 0, along * paled, along)
    chroma = max(float(np.hypot(*scale.center[1:])), LEAST_CHROMA)
    missing = np.maximum(0, _BODY.least_chroma - 1 - along * float(scale.spread[1:].mean()) / chroma)
    grey = _BODY.grey * missing**2 * min(1.0, chroma / SKIN_PRIOR.colors.full_chroma)
    squares = (along / np.where(along < 0, *_BODY.along)) ** 2 + (across / _BODY.across) ** 2
    return np.asarray((away > _LIT.lighter) & (_BODY.base - 0.5 * squares - grey > 0))


def _goes_over(lab: Floats, part: Bools, skin: Bools) -> float:
    """The share of a part's outline over which it goes over into skin without an edge.  All (h, w), lab (h, w, 3)."""
    own = part.astype(np.float32)
    outline = (cv2.dilate(part.view(np.uint8), _BESIDE) > 0) & ~part
    count = np.maximum(cv2.blur(own, (3, 3), borderType=cv2.BORDER_CONSTANT), 1e-6)
    beside = cv2.blur(lab * own[..., None], (3, 3), borderType=cv2.BORDER_CONSTANT) / count[..., None]
    step = np.linalg.norm((lab - beside)[outline], axis=1)
    return float((skin[outline] & (step < _LIT.step)).sum()) / max(int(outline.sum()), 1)
