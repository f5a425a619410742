"""What the mattes of the face and of the body have in common in a clip: how they are held to the frame before."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, ramp
from pvg.skin.parameters import SKIN_PRIOR

_TRACKING = SKIN_PRIOR.tracking


def places_before(flow: Floats) -> tuple[Floats, Floats]:
    """Maps x, y (h, w) float32 of where each cell was, by the flow (h, w, 2) in cells from now to then."""
    h, w = flow.shape[:2]
    x, y = flow[..., 0] + np.arange(w, dtype=np.float32), flow[..., 1] + np.arange(h, dtype=np.float32)[:, None]
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def weight_of_before(was: Bytes | Floats, now: Bytes | Floats) -> Floats:
    """(h, w) in [0, 1) the weight of the frame before in each cell, less where its picture, moved, was another.

    was, now: the pictures of then, moved onto now, and of now, 0-255: (h, w) float32, or (h, w, 3) uint8 RGB.
    """
    off = cv2.absdiff(was, now)
    if off.ndim == 3:
        off = cv2.cvtColor(off, cv2.COLOR_RGB2GRAY).astype(np.float32)
    change = cv2.blur(off, (_TRACKING.change_window, _TRACKING.change_window))
    return np.asarray(_TRACKING.keep * np.exp(-((change / _TRACKING.change) ** 2)), np.float32)


def soft_edge(probability: Floats, mask: Bools, blur: float) -> Floats:
    """The matte (h, w): the skin's probability around the mask's edge, 1 inside and 0 away from it.

    blur: cells, how far around.
    """
    near = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), blur)
    alpha = ramp(probability, *_TRACKING.edge_rise)
    outer, inner = _TRACKING.edge_core
    return np.asarray(np.where(near > inner, 1.0, np.where(near < outer, 0.0, alpha)), np.float32)


def in_levels(alpha: Floats) -> Bytes:
    """A matte in [0, 1] as bytes, in the steps that an asset keeps."""
    return np.asarray(np.rint(alpha * (255 / _TRACKING.alpha_step)) * _TRACKING.alpha_step, np.uint8)
