"""Collars: cloth that lies on a neck or chest, and is brighter and paler than the skin that it lies on.

A white collar beside warm skin has the skin's hue, by what it reflects and by mixed cells, and its brightness may be
that of a highlight. But skin gets darker towards the sides of a neck, and what is at once at the matte's edge, brighter
than the skin inside of it and of less chroma is cloth.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats, smoothstep
from pvg.picture import LUMA
from pvg.raster import square
from pvg.skin.cleanup import occupied
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape

_COLLAR = SKIN_PRIOR.collar
_LUMA = LUMA.astype(np.float32)
_LEAST_MASS = np.float32(1e-3)  # of sure skin around: with less nothing is told
_LEAST_LUMA = np.float32(1.0)  # levels


def collar(rgb: Bytes, probability: Floats, head: HeadShape) -> Floats:
    """(h, w) float32 in [0, 1], how surely each cell of a picture is a collar's and not skin.

    rgb: (h, w, 3), in usual light;  probability: (h, w) of skin, the face's and the rest of a person's together;
    head: in cells.
    """
    out = np.zeros(probability.shape, np.float32)
    y, x = (along.astype(np.float32) for along in np.ogrid[: probability.shape[0], : probability.shape[1]])
    way = ((x - head.chin[0]) * head.neck[0] + (y - head.chin[1]) * head.neck[1]) / np.float32(head.size)
    below = smoothstep(way, *_COLLAR.below_chin)
    # what reaches the picture's edge goes on there
    rows, columns = occupied(((below > 0) & (probability > _COLLAR.skin)).view(np.uint8), _COLLAR.edge)
    if not out[rows, columns].size:
        return out
    part, skin = rgb[rows, columns].astype(np.float32), probability[rows, columns]
    likely = (skin > _COLLAR.skin).astype(np.uint8)
    inner = cv2.erode(likely, square(_COLLAR.edge), borderType=cv2.BORDER_REPLICATE).astype(np.float32)
    luma = part @ _LUMA
    chroma = np.hypot(part[..., 0] - luma, part[..., 2] - luma) / np.maximum(luma, _LEAST_LUMA)
    sigma = max(1.0, _COLLAR.around * head.size)
    mass, mean_luma, mean_chroma = (
        cv2.GaussianBlur(values, (0, 0), sigma) for values in (inner, inner * luma, inner * chroma)
    )
    known = np.maximum(mass, _LEAST_MASS)
    brighter = smoothstep(luma * known / np.maximum(mean_luma, _LEAST_MASS), *_COLLAR.brighter)
    paler = 1 - smoothstep(chroma * known / np.maximum(mean_chroma, _LEAST_MASS * _LEAST_MASS), *_COLLAR.paler)
    found = brighter * paler * (1 - inner) * (mass > _LEAST_MASS)
    out[rows, columns] = cv2.GaussianBlur(found * below[rows, columns], (0, 0), _COLLAR.blur)
    return out
