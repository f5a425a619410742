"""Ears and neck in the face's matte: they keep their light beside the face.

The tone curve of a look stretches the tones of the open skin. An ear or a neck in the face's own shade lies below them,
and the curve, which is steep there for the sake of brows and folds, would make it much darker against the face than it
was. Outside the face's oval the membrane therefore also carries the difference between that curve and the one that
moves skin as the middle of the face is moved (`SkinMap.beside`). It is read at the matte's mean colour around each
node, so that texture and shape keep the face's contrast and nothing has an edge. The change of luma that the face's
curves ask for ends there: it would make the neck brighter than the chest, which has no curves. Their change of chroma
goes on, and evens the neck's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from pvg._arrays import Floats
from pvg.membrane import Lattice
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.correction import Correction
from pvg.rendering.map_tables import MapTables
from pvg.rendering.node_means import averaged, mean_codes
from pvg.rendering.placed_face import PlacedFace
from pvg.video import Frame

_FEATHER = 0.05  # of the face's width: how softly the face goes over into what is beside it [by eye]
_AROUND = 0.03  # of the face's width, sigma of the mean around a node [by eye]
_COARSE = 3  # nodes across a block: what is added is as smooth as its feather
_LEAST = 1e-3  # of alpha: where there is less, no mean is told


def with_beside(
    frame: Frame, placed: PlacedFace, corrections: Sequence[Correction], beside: Sequence[MapTables | None]
) -> list[Correction]:
    """The corrections of one face, all on one lattice, with what ears and neck take instead of their tables' gain.

    beside: for each correction the tables of skin beside the face, or None to leave it.
    """
    if all(tables is None for tables in beside):
        return list(corrections)
    lattice = corrections[0].lattice
    shape = -(-lattice.height // _COARSE), -(-lattice.width // _COARSE)
    share = _share_beside(placed, lattice, shape)
    nodes = share > 0
    if not nodes.any():
        return list(corrections)
    size = (lattice.width, lattice.height)
    kept = 1.0 - cv2.resize(share, size, interpolation=cv2.INTER_LINEAR)  # of luma's shift
    around, share = _means(frame, placed, shape)[nodes], share[nodes]
    out = []
    for correction, tables in zip(corrections, beside, strict=True):
        own = correction.contrast
        if tables is None or isinstance(own, float):
            out.append(correction)
            continue
        more = np.zeros((*shape, 3), np.float32)
        more[nodes] = (share * own.gained_more_by(tables, around)).T
        fine = cv2.resize(more, size, interpolation=cv2.INTER_LINEAR)
        shift = correction.shift.copy()
        shift[0] *= kept
        shift += np.moveaxis(fine, -1, 0)
        out.append(replace(correction, shift=shift))
    return out


def _share_beside(placed: PlacedFace, lattice: Lattice, shape: tuple[int, int]) -> Floats:
    """(h, w) on blocks of nodes: 0 within the face's oval, 1 well outside it."""
    landmarks = placed.data.landmarks
    oval = np.zeros(shape, np.float32)
    nodes = np.array([lattice.width / shape[1], lattice.height / shape[0]])  # of a block, a little less than _COARSE
    corner = np.array([lattice.x, lattice.y])
    corners = (landmarks.oval - corner - (nodes - 1) / 2 * lattice.step) / (nodes * lattice.step)  # from its middle
    cv2.fillPoly(oval, [fixed_point(corners.astype(np.float32))], 1.0, lineType=cv2.LINE_AA, shift=SUBPIXEL_BITS)
    sigma = _FEATHER * landmarks.axes.width / (_COARSE * lattice.step)
    soft = cv2.GaussianBlur(oval, (0, 0), max(0.5, sigma))
    return np.asarray(np.clip(1.0 - 2.0 * soft, 0.0, 1.0), np.float32)


def _means(frame: Frame, placed: PlacedFace, shape: tuple[int, int]) -> Floats:
    """(h, w, 3) mean codes of luma and chroma around each block of nodes, as the matte weighs them."""
    codes = mean_codes(frame, placed.window, shape)
    sigma = max(0.5, _AROUND * placed.data.landmarks.axes.width / (_COARSE * placed.lattice().step))
    alpha = averaged(placed.alpha, shape)[..., None]
    weight = cv2.GaussianBlur(alpha, (0, 0), sigma)[..., None]
    held = cv2.GaussianBlur(alpha * codes, (0, 0), sigma)
    return np.asarray(np.where(weight > _LEAST, held / np.maximum(weight, _LEAST), codes), np.float32)
