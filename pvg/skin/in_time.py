"""What the mattes of the face and of the body have in common in a clip: how they are held to the frame before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, ramp
from pvg.skin.parameters import SKIN_PRIOR

_TRACKING = SKIN_PRIOR.tracking

Maps = tuple[Floats, Floats]
"""x and y (h, w) of where each cell of a frame was in the frame before, in cells."""
Layer = TypeVar("Layer", Floats, Bytes)


@dataclass(frozen=True, eq=False)
class SkinInTime:
    """What one frame's skin leaves to the next, (h, w) float32 in [0, 1] each.

    mask: 0 or 1, and between them once it is moved.
    """

    probability: Floats
    mask: Floats
    alpha: Floats

    @property
    def layers(self) -> tuple[Floats, Floats, Floats]:
        """All of it, to be moved at once."""
        return self.probability, self.mask, self.alpha


def places_before(flow: Floats) -> Maps:
    """Maps x, y (h, w) float32 of where each cell was, by the flow (h, w, 2) in cells from now to then."""
    h, w = flow.shape[:2]
    x, y = flow[..., 0] + np.arange(w, dtype=np.float32), flow[..., 1] + np.arange(h, dtype=np.float32)[:, None]
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def moved(values: Layer, maps: Maps) -> Layer:
    """Values (h, w) or (h, w, c) of the frame before where its cells are now; beyond its edge that is repeated."""
    return np.asarray(cv2.remap(values, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), values.dtype)


def moved_layers(layers: Sequence[Floats], maps: Maps) -> list[Floats]:
    """Several (h, w) at once."""
    together = moved(np.asarray(cv2.merge(list(layers)), np.float32), maps)
    return [np.asarray(layer, np.float32) for layer in cv2.split(together)]


def weight_of_before(was: Bytes | Floats, now: Bytes | Floats) -> Floats:
    """(h, w) in [0, 1) the weight of the frame before in each cell, less where its picture, moved, was another.

    was, now: the pictures of then, moved onto now, and of now, 0-255: (h, w) float32, or (h, w, 3) uint8 RGB.
    """
    off = cv2.absdiff(was, now)
    if off.ndim == 3:
        off = cv2.cvtColor(off, cv2.COLOR_RGB2GRAY).astype(np.float32)
    change = cv2.blur(off, (_TRACKING.change_window, _TRACKING.change_window))
    return np.asarray(_TRACKING.keep * np.exp(-((change / _TRACKING.change) ** 2)), np.float32)


def held(
    probability: Floats,
    before: tuple[SkinInTime, Floats] | None,
    parts: Callable[[Floats, Bools], Bools],
    edge_blur: float,
) -> tuple[Bools, SkinInTime]:
    """A frame's mask (h, w) bool and skin, held to the frame before where nothing changed.

    before: the skin of the frame before, moved, and its weight (h, w), see `weight_of_before`; None of a first frame;
    parts: the mask (h, w) of a probability (h, w) and where it is likely skin (h, w) bool;  edge_blur: see `soft_edge`.
    """
    likely = probability > 0.5
    if before is not None:
        was, keep = before
        probability = (probability + keep * (was.probability - probability)).astype(np.float32)
        likely = probability + _TRACKING.hysteresis * keep * (was.mask - 0.5) > 0.5
    mask = parts(probability, likely)
    alpha = soft_edge(probability, mask, edge_blur)
    if before is not None:
        alpha = (alpha + keep * (was.alpha - alpha)).astype(np.float32)
    return mask, SkinInTime(probability, mask.astype(np.float32), alpha)


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
