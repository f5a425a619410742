"""What passes in front of a face: cells of another hue than skin where the key frame showed open skin.

Brightness says nothing, for shade and highlights come and go, and neither does greyness, for gloss is grey. So a
hand, grey hair and a black microphone are not told from skin in another light; a coloured thing is.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Floats
from pvg.raster import square
from pvg.skin._kernels import HueLine, foreign_hue, hue_distance
from pvg.skin.color_model import ColorScale
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior

_OCCLUSION = SKIN_PRIOR.occlusion
_FOREIGN, _VISIBLE = (np.array(r, np.float32) for r in (_OCCLUSION.foreign_rise, _OCCLUSION.visible_rise))
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def _hue_line(scale: ColorScale) -> HueLine:
    """The hue line of the key frame's skin."""
    spread: Floats = scale.spread[1:]
    return HueLine(scale.center[1:] / spread, spread, np.float32(_OCCLUSION.most_chroma))


def open_skin(lab: Floats, scale: ColorScale, mask: Bools) -> Floats:
    """(h, w) float32, 1 where the key frame's mask shows the skin's own hue and nothing else nearby."""
    distance = np.empty(mask.shape, np.float32)
    hue_distance(lab, _hue_line(scale), distance)
    plain = (mask & (distance < _OCCLUSION.foreign_rise[0])).astype(np.uint8)
    return cv2.erode(plain, _NEIGHBOURS).astype(np.float32)


def _foreign_hue(lab: Floats, scale: ColorScale, cells: Bools) -> Floats:
    """How surely colours (h, w, 3) are not skin's in any light: (h, w) in [0, 1], 0 but in `cells` (h, w)."""
    out = np.empty(cells.shape, np.float32)
    foreign_hue(lab, cells, _hue_line(scale), _FOREIGN, _VISIBLE, out)
    return out


def occluder_alpha(lab: Floats, scale: ColorScale, was_open: Floats, prior: SpatialPrior) -> Floats:
    """Alpha of what lies in front of the face: (h, w) float32 in [0, 1].

    lab: (h, w, 3), in the key frame's light;  was_open: (h, w), `open_skin` carried from the key frame.
    """
    known = (was_open > _OCCLUSION.known) & ~prior.features
    foreign = _foreign_hue(lab, scale, known)
    if not (foreign > 0.5).any():  # as in nearly all frames
        return np.zeros(known.shape, np.float32)
    solid = cv2.morphologyEx(foreign, cv2.MORPH_OPEN, _NEIGHBOURS)
    count, labels, stats, _ = cv2.connectedComponentsWithStats((solid > 0.5).astype(np.uint8), connectivity=8)
    kept = stats[:, cv2.CC_STAT_AREA] > _OCCLUSION.least_part * prior.size**2
    kept[0] = False
    if count <= 1 or not kept.any():
        return np.zeros(known.shape, np.float32)
    solid = np.where(cv2.dilate(kept[labels].astype(np.uint8), _NEIGHBOURS) > 0, solid, 0)
    # features have hues of their own: what lies in front of one of them is told by what lies on both sides of it
    between = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, square(_OCCLUSION.between * prior.size))
    solid = np.where(prior.features, np.minimum(_foreign_hue(lab, scale, prior.features), between), solid)
    grown = cv2.dilate(solid, _NEIGHBOURS)
    soft = cv2.GaussianBlur(grown, (0, 0), _OCCLUSION.soft)
    return np.asarray(np.minimum(_OCCLUSION.harden * soft, 1.0), np.float32)
