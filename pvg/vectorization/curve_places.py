"""Where the diffusion curves γ of a frame lie: some by its landmarks, the mask's boundary by its matte."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.curves import boundary_points, boundary_radius, place, table_labels
from pvg.face import FaceAxes, Landmarks
from pvg.skin import Matte

_INSET = 0.02  # of the face's width: boundary samples lie so far inside the mask, off the hair and wall beside it


def inset_radius(landmarks: Landmarks, matte: Matte) -> Floats:
    """(192,) float32 radii of the mask's boundary around the face's centre, source pixels, see `boundary_radius`."""
    axes = FaceAxes.of(matte.raster.to_cells(landmarks.points))
    cells = boundary_radius(matte.alpha.astype(np.float32) / 255.0, axes)
    radius: Floats = np.maximum(cells * matte.raster.step - _INSET * landmarks.axes.width, 0.0).astype(np.float32)
    return radius


def curve_positions(landmarks: Landmarks, matte: Matte) -> Floats:
    """(S, 2) the samples of the table's labels on a face with this matte, source pixels."""
    return place(table_labels(), landmarks, boundary_points(inset_radius(landmarks, matte), landmarks.axes))
