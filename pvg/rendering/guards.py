"""Guards: eyes and teeth keep their own colour, so they are taken out of the matte."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pvg._arrays import Floats
from pvg.face import layout
from pvg.face.cover import soft_cover
from pvg.raster import scaled
from pvg.rendering.placed_face import PlacedFace

_FEATHER = 0.015  # of the face's width [by eye: narrow eyes stay dark, no rim is seen]
_CELLS_A_SPREAD = 2.0  # at least; so the guards of large faces are blurred on cells of several pixels


def guarded_alpha(face: PlacedFace, protect: Sequence[str], *, in_place: bool = False) -> Floats:
    """The face's matte (h, w) without the features that keep their own colour ("eyes", "teeth").

    in_place: whether the face's own matte may be changed, since nobody needs it again.
    """
    landmarks = face.data.landmarks
    polygons: list[Floats] = []
    if "eyes" in protect:
        polygons += [landmarks.points[layout.LEFT_EYE], landmarks.points[layout.RIGHT_EYE]]
    if "teeth" in protect:
        polygons.append(landmarks.points[layout.LIPS_INNER])
    if not polygons:
        return face.alpha
    sigma = max(0.8, _FEATHER * landmarks.axes.width)
    origin = np.array([face.x, face.y], np.float32)
    alpha = face.alpha if in_place else face.alpha.copy()
    for polygon in polygons:
        _take_out(alpha, polygon - origin, sigma)
    return alpha


def _take_out(alpha: Floats, polygon: Floats, sigma: float) -> None:
    """Fade alpha to 0 inside a polygon of its pixels, over roughly `sigma` at its edge, in place."""
    cell = max(1, int(sigma / _CELLS_A_SPREAD))
    guard, (column, row) = soft_cover(scaled(polygon, 1.0 / cell), sigma / cell)
    if cell > 1:
        size = guard.shape[1] * cell, guard.shape[0] * cell
        guard = np.asarray(cv2.resize(guard, size, interpolation=cv2.INTER_LINEAR), np.float32)
    x0, y0 = column * cell, row * cell
    part = alpha[max(y0, 0) : max(y0 + guard.shape[0], 0), max(x0, 0) : max(x0 + guard.shape[1], 0)]
    top, left = max(-y0, 0), max(-x0, 0)
    part *= 1.0 - guard[top : top + part.shape[0], left : left + part.shape[1]]
