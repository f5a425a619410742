"""Where a mouth's outline shows lips: fingers, a microphone or an outline that is a little off show something else.

Lips are told from what else is there by what sets them apart from the skin on the key frame, the tint c: chroma over
luma, which light changes little, and a little of how dark they are beside what lies around the mouth:

    t = (c − c_skin) · (c_lips − c_skin) / |c_lips − c_skin|²        1 on lips, 0 on skin

A change meant for lips is given to what is at least some way from skin to lips.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Floats, smoothstep
from pvg.asset import KeyFrame
from pvg.face import Landmarks, layout
from pvg.face.parts import PARTS
from pvg.membrane import Lattice
from pvg.rendering.coding import Coding
from pvg.rendering.node_means import mean_codes
from pvg.video import Frame

_APART = 0.06  # of chroma over luma: lips that are nearer to the skin are not told from it [by eye]
_SHOWN = (0.0, 0.4)  # t from which lips begin, and are all lips: highlights on them are pale [by eye]
_AROUND = 0.02  # of the face's width: spread of the mean that t is taken of, against noise [by eye]
_MARGIN = 0.06  # of the face's width around the outline
_LUMA = np.float32(0.3)  # of the logarithm of luma beside chroma over luma: grey lips are told by it [by eye]
_OTHER = np.float32(0.15)  # of that, at most: by how much the light of the frame may be another one
_DARKEST = np.float32(8.0)  # levels of luma above black: below, a tint says nothing


def lips_shown(frame: Frame, landmarks: Landmarks, key: KeyFrame, lattice: Lattice) -> Floats | None:
    """(h, w) in [0, 1] on the lattice's nodes, how far each shows lips; 1 away from the mouth. None: they are not told.

    key: whose lips and skin are compared.
    """
    lips = key.parts[PARTS.index("lips")]
    if not len(key.skin) or np.isnan(lips).any():
        return None
    level = np.float32(2.0 ** (frame.format.depth - 8))
    colors = np.stack([lips, key.skin_median]).astype(np.float32)
    own, skin = _tints(Coding(frame.format).colors(colors), level)
    apart = own - skin
    if float(np.linalg.norm(apart)) < _APART:
        return None
    width = max(landmarks.axes.width, 1.0)
    outline = landmarks.points[layout.LIPS_OUTER]
    low, high = outline.min(axis=0) - _MARGIN * width, outline.max(axis=0) + _MARGIN * width
    corner = np.array([lattice.x, lattice.y], np.float32)
    first = np.maximum(np.floor((low - corner) / lattice.step), 0).astype(int)
    last = np.minimum(np.ceil((high - corner) / lattice.step).astype(int) + 1, [lattice.width, lattice.height])
    align = 2 ** max(frame.format.chroma_log2)
    begin = (corner + first * np.float32(lattice.step)).astype(int) // align * align
    end = np.minimum((corner + last * np.float32(lattice.step)).astype(int), [frame.width, frame.height])
    if (last - first).min() < 2 or (end - begin).min() < 2:
        return None
    columns, rows = (last - first).tolist()
    codes = mean_codes(frame, (*begin.tolist(), *end.tolist()), (rows, columns))
    codes -= np.asarray(frame.format.opponent.offset, np.float32)
    sigma = max(0.5, _AROUND * width / lattice.step)
    tints = _tints(np.asarray(cv2.GaussianBlur(codes, (0, 0), sigma), np.float32), level)
    tints[..., 2] += np.clip(skin[2] - _beside(tints[..., 2], _MARGIN * width / lattice.step), -_OTHER, _OTHER)
    found = (tints - skin) @ apart / float(apart @ apart)
    out = np.ones((lattice.height, lattice.width), np.float32)
    out[first[1] : last[1], first[0] : last[0]] = smoothstep(found, *_SHOWN)
    return out


def _beside(plane: Floats, margin: float) -> Floats:
    """What a plane (h, w) would be if all of it were the skin along its border: its median and slopes there.

    Light from one side makes lips on that side as bright as skin on the other one.
    """
    h, w = plane.shape
    border = np.ones((h, w), np.bool_)
    wide = max(1, int(0.5 * margin))
    border[wide:-wide, wide:-wide] = False
    y, x = np.mgrid[:h, :w].astype(np.float32)
    y, x = y - (h - 1) / 2, x - (w - 1) / 2
    values = plane[border]
    middle = np.median(values)
    off = np.clip(values - middle, -_OTHER, _OTHER)
    x_border, y_border = x[border], y[border]  # even about the middle, so that each slope is told alone
    slopes = [float(off @ at) / float(at @ at) for at in (x_border, y_border)]
    return np.asarray(middle + slopes[0] * x + slopes[1] * y, np.float32)


def _tints(codes: Floats, level: np.float32) -> Floats:
    """(…, 3) chroma over luma, and the logarithm of luma, of codes (…, 3);  level: codes a level of 255."""
    luma = np.maximum(codes[..., :1], _DARKEST * level)
    return np.asarray(np.concatenate([codes[..., 1:] / luma, _LUMA * np.log(luma)], axis=-1), np.float32)
