"""Partial matching: how far each curve sample is seen in a frame, and what a hidden one does meanwhile.

A sample is hidden on the far side of a turned head, outside the picture, or where the matte says that something else
than skin lies in front of it. The landmark model reports such places with full confidence, so the head's pose, the
picture and the matte decide. A hidden sample must not impose its own colour there; switching it off would let the
membrane jump. Instead its value runs smoothly over to what the seen samples around it say, which is nearly what the
membrane would be without it, and back when it returns. All of it follows from one frame's geometry, so any frame can be
drawn alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats, smoothstep
from pvg._compiled import kernel
from pvg.asset import FaceInFrame
from pvg.curves import BOUNDARY, GROUPS, CurveLabels
from pvg.face import layout

_BOUNDARY_AZIMUTH = 80.0  # at the ears, where the mask boundary lies sideways of the face's centre

_TURNED_AWAY = (85.0, 112.0)  # degrees from the camera: seen up to the first, hidden from the second
_PICTURE_EDGE = 0.012  # of the face's width: seen from so far inside the picture on
_MATTE = (0.2, 0.6)  # hidden below the first, seen from the second
_MATTE_BLUR = 0.02  # of the face's width
# of the face's width: a mask boundary nearer to the centre runs along something in front of the face
_REACH = (0.2, 0.4)
_NEAR = 0.1  # of the face's width: what is nearer counts little more, so that no sample rules until it vanishes
_OTHER_GROUP = 1e-3  # lips take from lips, skin from skin, while there are any
_OWN = 1e-3  # where nothing at all is seen, a sample keeps its own value


@dataclass(frozen=True, eq=False)
class Visibility:
    """How far the samples of one frame's curves are seen.

    weight: (S,) float32 in [0, 1], 1 where seen;  fading: (R,) the samples with a weight below 1;
    share: (R, S) float32, rows of sum 1: what they take from the samples when hidden.
    """

    weight: Floats
    fading: NDArray[np.intp]
    share: Floats

    def settle(self, values: Floats) -> Floats:
        """Values (S, C) at the samples with those of hidden ones replaced; linear, and constants stay what they are."""
        if not len(self.fading):
            return values
        known = np.array(values.T, np.float32, order="C")  # a copy of one channel too
        _settle(known, self.fading, self.weight, np.asarray(cv2.transpose(self.share)))
        return np.ascontiguousarray(known.T)


@kernel()
def _settle(values: Floats, fading: NDArray[np.intp], weight: Floats, share: Floats) -> None:
    """Move values (C, S) of the samples `fading` (R,) by 1 − weight towards share (S, R) of all, in place.

    Summed in the order of the samples: a channel comes out the same whatever others stand beside it, which a matrix
    product does not promise.
    """
    total = np.empty(len(fading), np.float32)
    for known in values:
        total[:] = np.float32(0.0)
        for s in range(len(known)):
            own, parts = known[s], share[s]
            for r in range(len(total)):
                total[r] += parts[r] * own
        for r in range(len(fading)):
            k = fading[r]
            known[k] += (np.float32(1.0) - weight[k]) * (total[r] - known[k])


def see(data: FaceInFrame, labels: CurveLabels, positions: Floats, width: int, height: int) -> Visibility:
    """Which samples at `positions` (S, 2), source pixels, are seen in a picture of `width` x `height`."""
    axes = data.landmarks.axes
    unit = max(axes.width, 1.0)
    away = np.abs(_azimuth(labels) + _turn(data.pose))
    weight = 1.0 - smoothstep(away, *_TURNED_AWAY)
    margin = np.minimum(positions, np.array([width - 1, height - 1], np.float32) - positions).min(axis=1)
    weight *= smoothstep(margin / unit, 0.0, _PICTURE_EDGE)
    on_boundary = labels.curve == BOUNDARY
    weight[on_boundary] *= smoothstep(np.linalg.norm(positions[on_boundary] - axes.center, axis=1) / unit, *_REACH)
    on_skin = labels.on_open_skin
    weight[on_skin] *= smoothstep(_matte_at(data, positions[on_skin], unit), *_MATTE)
    fading = np.flatnonzero(weight < 1.0)
    return Visibility(weight, fading, _shares(labels, positions / np.float32(unit), weight, fading))


def _turn(pose: Floats) -> float:
    """Degrees by which a head of pose (3,) is turned about its own axis, from crown to chin, to its own left.

    Yaw is about the picture's: of a head that lies on its side, what it nods counts there, too.
    """
    yaw, pitch, roll = np.radians(pose.astype(np.float64))
    across = np.sin(yaw) * np.cos(roll) + np.sin(pitch) * np.cos(yaw) * np.sin(roll)
    return float(np.degrees(np.arctan2(across, np.cos(yaw) * np.cos(pitch))))


@lru_cache(maxsize=2)
def _azimuth(labels: CurveLabels) -> Floats:
    """(S,) degrees by which each sample's skin looks to the image's right on a face held straight."""
    sideways = np.sin(2 * np.pi * labels.s[labels.curve == BOUNDARY])  # the boundary's s is an angle from the chin
    on_landmarks = np.clip(labels.basis @ layout.AZIMUTH_DEG, -90.0, 90.0)
    return np.concatenate([on_landmarks, _BOUNDARY_AZIMUTH * sideways]).astype(np.float32)


def _matte_at(data: FaceInFrame, positions: Floats, unit: float) -> Floats:
    """(n,) the matte around the positions in [0, 1], whatever the opacity of a face that is being lost."""
    raster, alpha = data.matte.raster, data.matte.alpha
    full = max(int(alpha.max()), 1)
    side = 2 * round(_MATTE_BLUR * unit / raster.step * 1.7) + 1  # two boxes are as wide as a Gaussian of that spread
    soft = cv2.blur(cv2.blur(alpha, (side, side)), (side, side))
    cells = raster.to_cells(positions)
    x, y = (np.ascontiguousarray(cells[None, :, axis]) for axis in (0, 1))
    read = cv2.remap(soft.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(read[0] / full)


def _shares(labels: CurveLabels, places: Floats, weight: Floats, fading: NDArray[np.intp]) -> Floats:
    """(R, S) inverse-distance shares of the seen samples in each fading one; places: (S, 2) in face widths."""
    if not len(fading):
        return np.empty((0, len(weight)), np.float32)
    centered = places - places[fading].mean(axis=0)
    length = np.einsum("sk,sk->s", centered, centered)
    squared = length[fading, None] + length - 2.0 * (centered[fading] @ centered.T)
    of_group = np.array([np.where(labels.group == k, weight, _OTHER_GROUP * weight) for k in range(len(GROUPS))])
    share = of_group[labels.group[fading]]
    share /= (np.maximum(squared, 0.0) + np.float32(_NEAR**2)) ** 2
    share[np.arange(len(fading)), fading] += _OWN
    share /= share.sum(axis=1, keepdims=True)
    return np.asarray(share, np.float32)
