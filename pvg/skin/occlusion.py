"""What passes before a face: cells of another hue than skin where the key frame showed open skin.

Brightness says nothing, for shade and highlights come and go, and neither does greyness, for gloss is grey. So a
hand, grey hair and a black microphone are not told from skin in another light; a coloured thing is.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Floats
from pvg.skin._kernels import foreign_share, off_hue
from pvg.skin.color_model import ColorScale
from pvg.skin.prior import Places

_SKIN, _OTHER = 4.0, 7.0  # spreads off the skin's line of hue: skin below the first, another thing from the second
_DARKEST = (15.0, 25.0)  # L: darker cells show no hue
_MOST_COLORFUL = 1.6  # times the skin's chroma: flushed, or in deep shade
_KNOWN = 0.95  # of a cell carried from the key frame that was open skin there
_LEAST_PART = 0.006  # squared face sizes: smaller spots are blemishes, or lips that moved
_BETWEEN = 0.16  # face sizes: half of the widest gap, a brow and an eye
_SOFT = 0.7  # cells


def _line_of_hue(scale: ColorScale) -> tuple[Floats, Floats, np.float32]:
    """The skin's a and b in spreads (2,), those spreads (2,), and how many times as far its line of hue goes."""
    spread: Floats = scale.spread[1:]
    return scale.center[1:] / spread, spread, np.float32(_MOST_COLORFUL)


def open_skin(lab: Floats, scale: ColorScale, mask: Bools) -> Floats:
    """(h, w) float32, 1 where the key frame's mask shows the skin's own hue and nothing else nearby."""
    distance = np.empty(mask.shape, np.float32)
    off_hue(lab, *_line_of_hue(scale), distance)
    plain = (mask & (distance < _SKIN)).astype(np.uint8)
    return cv2.erode(plain, np.ones((3, 3), np.uint8)).astype(np.float32)


def _foreign(lab: Floats, scale: ColorScale, cells: Bools) -> Floats:
    """How surely colours (h, w, 3) are not skin's in any light: (h, w) in [0, 1], 0 but in `cells` (h, w)."""
    out = np.empty(cells.shape, np.float32)
    bounds, darkest = np.array([_SKIN, _OTHER], np.float32), np.array(_DARKEST, np.float32)
    foreign_share(lab, cells, *_line_of_hue(scale), bounds, darkest, out)
    return out


def occlusion(lab: Floats, scale: ColorScale, was_open: Floats, where: Places) -> Floats:
    """How surely something lies before the face: (h, w) float32 in [0, 1].

    lab: (h, w, 3), in the key frame's light;  was_open: (h, w), `open_skin` carried from the key frame.
    """
    known = (was_open > _KNOWN) & ~where.features
    seen = _foreign(lab, scale, known)
    if not (seen > 0.5).any():  # as in nearly all frames
        return np.zeros(known.shape, np.float32)
    solid = cv2.morphologyEx(seen, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats((solid > 0.5).astype(np.uint8), connectivity=8)
    kept = stats[:, cv2.CC_STAT_AREA] > _LEAST_PART * where.size**2
    kept[0] = False
    if count <= 1 or not kept.any():
        return np.zeros(known.shape, np.float32)
    solid = np.where(cv2.dilate(kept[labels].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0, solid, 0)
    # features have hues of their own: what lies before one of them is told by what lies on both sides of it
    reach = 2 * max(1, round(_BETWEEN * where.size)) + 1
    between = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, np.ones((reach, reach), np.uint8))
    solid = np.where(where.features, np.minimum(_foreign(lab, scale, where.features), between), solid)
    grown = cv2.dilate(solid, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.GaussianBlur(grown, (0, 0), _SOFT), np.float32)
