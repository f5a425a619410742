"""The face's own axes in a picture: where its middle is, which way is down, how wide it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Floats
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
        x, y, across_x, across_y, width = _axes(np.asarray(points, np.float32), _LEFT_EYE, _RIGHT_EYE, _CONTOUR)
        across = np.array([across_x, across_y], np.float32)
        return cls(np.array([x, y], np.float32), np.array([-across[1], across[0]], np.float32), across, width)


@kernel()
def _axes(
    points: Floats, left_eye: layout.Indices, right_eye: layout.Indices, contour: layout.Indices
) -> tuple[float, float, np.float32, np.float32, float]:
    """x and y of the centre, of the unit vector across, and the width.

    The axes are wanted several times a frame, and the points are too few for array operations to pay.
    """
    left, right = np.zeros(2, np.float32), np.zeros(2, np.float32)
    for axis in range(2):
        for k in left_eye:
            left[axis] += points[k, axis]
        for k in right_eye:
            right[axis] += points[k, axis]
    left /= np.float32(len(left_eye))
    right /= np.float32(len(right_eye))
    apart = right - left
    length = max(np.hypot(apart[0], apart[1]), np.float32(1e-6))
    across_x, across_y = apart[0] / length, apart[1] / length
    x = (left[0] + right[0]) / 2.0 - across_y * _CENTER_BELOW_EYES * length
    y = (left[1] + right[1]) / 2.0 + across_x * _CENTER_BELOW_EYES * length
    low, high = np.inf, -np.inf
    for k in contour:
        along = (points[k, 0] - x) * across_x + (points[k, 1] - y) * across_y
        low, high = min(low, along), max(high, along)
    return x, y, across_x, across_y, high - low
