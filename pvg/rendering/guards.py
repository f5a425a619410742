"""Guards: eyes and teeth keep their own colour, so they are taken out of the matte."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from pvg._arrays import Floats
from pvg.face import layout
from pvg.raster import SUBPIXEL_BITS, fixed_point, scaled
from pvg.rendering.placed_face import PlacedFace

_FEATHER = 0.015  # of the face's width [by eye: narrow eyes stay dark, no rim is seen]
_REACH = 3.0  # spreads of the feather after which next to nothing is left of it
_FINER = 4  # guards are drawn this many times finer than their cells
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
    reach = int(np.ceil(_REACH * sigma / cell))
    x0, y0 = ((int(v) // cell - reach) * cell for v in np.floor(polygon.min(axis=0)))
    columns, rows = (
        int(v - low) // cell + reach + 1 for v, low in zip(np.ceil(polygon.max(axis=0)), (x0, y0), strict=True)
    )
    part = alpha[max(y0, 0) : max(y0 + rows * cell, 0), max(x0, 0) : max(x0 + columns * cell, 0)]
    if not part.size:
        return
    # The share of each cell that the polygon covers: the guard goes as lips and lids close. OpenCV draws every polygon
    # a pixel too wide, so that closed ones would keep a guard, and trembles; drawn finer, both are too small to see.
    finer = np.zeros((rows * _FINER, columns * _FINER), np.uint8)
    corners = scaled(polygon - np.array([x0, y0], np.float32), _FINER / cell)
    cv2.fillPoly(finer, [fixed_point(corners)], (255,), shift=SUBPIXEL_BITS)
    covered = cv2.resize(finer, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32) / np.float32(255.0)
    side = 2 * reach + 1
    soft = cv2.GaussianBlur(covered, (side, side), sigma / cell, borderType=cv2.BORDER_CONSTANT)
    guard = soft if cell == 1 else cv2.resize(soft, (columns * cell, rows * cell), interpolation=cv2.INTER_LINEAR)
    top, left = max(-y0, 0), max(-x0, 0)
    part *= 1.0 - guard[top : top + part.shape[0], left : left + part.shape[1]]
