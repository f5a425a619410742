"""The face's own axes in a picture: where its middle is, which way is down, how wide it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg._compiled import kernel
from pvg.face import layout

_CENTER_BELOW_EYES = 0.75  # of the distance between the eyes' middles, down from between them [by eye: above the lips]
_LEFT_EYE, _RIGHT_EYE, _CONTOUR = layout.LEFT_EYE_CONTOUR, layout.RIGHT_EYE_CONTOUR, layout.CONTOUR


@dataclass(frozen=True, eq=False)
class FaceAxes:
    """The only coordinate frame of a face.

    center: (2,) float32 source pixels, between mouth and nose;  down: (2,) float32 unit vector towards the chin;
    across: (2,) float32 unit vector from the left eye to the right one;  width: extent of the face contour along it,
    source pixels.
    """

    center: Floats
    down: Floats
    across: Floats
    width: float

    @classmethod
    def of(cls, points: Floats) -> FaceAxes:
        """The axes of (106, 2) landmarks.

        The direction comes from the line between the eye contours' centres, which speech and smiles do not move.
        """
        x, y, down_x, down_y, width = _axes(np.asarray(points, np.float64), _LEFT_EYE, _RIGHT_EYE, _CONTOUR)
        down = np.array([down_x, down_y], np.float32)
        return cls(np.array([x, y], np.float32), down, np.array([down[1], -down[0]], np.float32), width)


@kernel()
def _axes(
    points: Doubles, left_eye: layout.Indices, right_eye: layout.Indices, contour: layout.Indices
) -> tuple[float, float, float, float, float]:
    """x and y of the centre, of the downward unit vector, and the width; the axes are wanted several times a frame,
    and the points are too few for array operations to pay."""
    left_x, left_y, right_x, right_y = 0.0, 0.0, 0.0, 0.0
    for k in left_eye:
        left_x += points[k, 0] / len(left_eye)
        left_y += points[k, 1] / len(left_eye)
    for k in right_eye:
        right_x += points[k, 0] / len(right_eye)
        right_y += points[k, 1] / len(right_eye)
    across_x, across_y = right_x - left_x, right_y - left_y
    length = np.sqrt(across_x**2 + across_y**2)
    down_x, down_y = -across_y / max(length, 1e-6), across_x / max(length, 1e-6)
    x = (left_x + right_x) / 2 + down_x * _CENTER_BELOW_EYES * length
    y = (left_y + right_y) / 2 + down_y * _CENTER_BELOW_EYES * length
    low, high = np.inf, -np.inf
    for k in contour:
        along = (points[k, 0] - x) * down_y - (points[k, 1] - y) * down_x
        low, high = min(low, along), max(high, along)
    return x, y, down_x, down_y, high - low
