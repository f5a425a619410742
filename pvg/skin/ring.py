"""Hair beside the face, told by the ring around the head: what is nearer to the ring's colours than to the face's."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Floats, ramp
from pvg.skin.color_model import ColorScale, inlier_covariance, to_skin_lab
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.light import relit
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape

_RING, _BODY = SKIN_PRIOR.ring, SKIN_PRIOR.body


def hair_odds(seen: FaceInScene, scale: ColorScale, gain: Floats) -> Floats:
    """(h, w) float32 nats against skin in the cells of a scene, 0 where no hair is known.

    scale: of the face's skin on the key frame;  gain: (3,) to its light.
    """
    out = np.zeros(seen.face_mask.shape, np.float32)
    side, depth = seen.head.places(out.shape)
    side = np.abs(side)
    face = cv2.erode((seen.face_mask > 0.5).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    samples = [np.flatnonzero(part) for part in (_ring(seen, side, depth), face)]
    if min(len(sample) for sample in samples) < _RING.least:
        return out
    samples = [sample[:: 1 + len(sample) // _RING.most_sample] for sample in samples]
    share = _share(seen.head, side, depth)
    asked = (seen.person > 255 * _BODY.no_person) & ~face & (share > 0)
    colors = seen.rgb.reshape(-1, 1, 3)[np.concatenate([*samples, np.flatnonzero(asked)])]
    lab = to_skin_lab(relit(colors, gain))[:, 0]
    z = np.asarray((lab - scale.center) / scale.spread, np.float32)
    of_ring, of_face, z = np.split(z, np.cumsum([len(sample) for sample in samples]))
    hair, skin = (_likelihood(z, sample) for sample in (of_ring, of_face))
    out[asked] = share[asked] * np.clip(_RING.weight * (hair - skin + _RING.prior), 0, _RING.most)
    return out


def _ring(seen: FaceInScene, side: Floats, depth: Floats) -> Bools:
    """(h, w) bool, the cells around the head that are a person's and apart from the face's own mask.

    side, depth: (h, w) of the cells, face sizes from the head's middle, see `HeadShape.places`; side without its sign.
    """
    half_width, half_height = _half_sizes(seen.head)
    # half an ellipse over the head, upright below its middle
    away = np.hypot(side / (half_width + _BODY.head_beside), np.minimum(depth, 0) / (half_height + _BODY.head_above))
    around = (away > _RING.inner) & (away < 1) & (depth < half_height + _RING.below)
    margin = np.ones((2 * _RING.apart + 1,) * 2, np.uint8)
    apart = cv2.dilate((seen.face_mask > 0).astype(np.uint8), margin) == 0
    return np.asarray(around & (seen.person > 255 * _RING.person) & apart)


def _share(head: HeadShape, side: Floats, depth: Floats) -> Floats:
    """(h, w) in [0, 1], how far the ring speaks for each cell: less with distance, and less before the neck."""
    half_width, _ = _half_sizes(head)
    start, end = _RING.reach
    share = ramp(np.hypot(side, depth), end, start)
    return np.asarray(np.where(depth > 0, share * ramp(side / half_width, *_RING.neck_rise), share))


def _half_sizes(head: HeadShape) -> tuple[float, float]:
    """Half the width and half the height of a head's oval, in face sizes."""
    return head.width / 2 / head.size, head.height / 2 / head.size


def _likelihood(z: Floats, sample: Floats) -> Floats:
    """(n,) log-likelihood of colours z (n, 3) by the normal distribution of most of a sample (m, 3)."""
    center = np.median(sample, axis=0)
    covariance = inlier_covariance(sample, center, _RING.inlier, _RING.inlier_margin) + np.eye(3) * _RING.noise**2
    root = np.linalg.cholesky(np.linalg.inv(covariance)).astype(np.float32)
    squares = (((z - center) @ root) ** 2).sum(axis=1)
    level = 0.5 * float(np.log(np.linalg.det(covariance)))
    return np.asarray(-0.5 * np.minimum(squares, _RING.furthest) - level, np.float32)
