"""One face in one frame, ready to be solved and drawn: its matte over whole pixels and its curves on the lattice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pvg._arrays import Bools, Floats
from pvg.asset import FaceInFrame
from pvg.curves import BOUNDARY, CurveLabels, place
from pvg.membrane import TARGET_HEIGHT, TOLERANCE, Lattice, Membrane, build_membrane, cut_edges
from pvg.picture import Box, common, slices_of
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.visibility import Visibility, see

_BESIDE_OVAL = 0.02  # claim of a face's ears and neck, against 1 within its oval
_OVAL_EDGE = 0.03  # of the face's width
_CELLS = 8  # of the matte's raster: steps in which a face grows, so that its lattice seldom changes
_NEARER = 4  # of two faces the larger is likely the nearer: claims grow with this power of the width


@dataclass(frozen=True, eq=False)
class PlacedFace:
    """One face in one frame, ready for any number of looks.

    data: its geometry;  labels: of its S curve samples;  positions: (S, 2) of them, source pixels;  active: (S,) those
    that lie anywhere;  x, y: the source pixel of the region's corner;  alpha: (h, w) float32 matte in [0, 1], h and w
    multiples of the chroma step unless the picture ends there;  visibility: which of its samples are seen.
    """

    data: FaceInFrame
    labels: CurveLabels
    positions: Floats
    active: Bools
    x: int
    y: int
    alpha: Floats
    visibility: Visibility

    def lattice(self, nodes: int = TARGET_HEIGHT) -> Lattice:
        """The lattice over the region, `nodes` along its height."""
        return Lattice.over((self.x, self.y, self.alpha.shape[1], self.alpha.shape[0]), target_height=nodes)

    @property
    def window(self) -> Box:
        """The box of its pixels in the picture."""
        return self.x, self.y, self.x + self.alpha.shape[1], self.y + self.alpha.shape[0]

    def membrane(self, values: Floats, *, tolerance: float = TOLERANCE, nodes: int = TARGET_HEIGHT) -> Membrane:
        """Harmonic extension of values (S, C) at the curves, hidden samples following those that are seen.

        tolerance: estimated largest error, in the units of the values;  nodes: see `lattice`.
        """
        cuts = cut_edges(self.positions, self.labels.spans, self.lattice(nodes), active=self.active)
        return build_membrane(cuts).solve(self.visibility.settle(values), tolerance=tolerance)


def place_face(data: FaceInFrame, labels: CurveLabels, width: int, height: int, align: int = 2) -> PlacedFace | None:
    """Place a face's curves and matte in a picture of `width` x `height`; None when nothing of it is in the picture.

    align: the chroma step.
    """
    if data.score <= 0 or not data.matte.alpha.any():
        return None
    box = _occupied(data)
    x0, y0 = (max(0, int(np.floor(v)) // align * align) for v in box[:2])
    x1 = min(width, -(-int(np.ceil(box[2])) // align) * align)
    y1 = min(height, -(-int(np.ceil(box[3])) // align) * align)
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    alpha = data.matte.alpha_at(np.arange(x0, x1, dtype=np.float32), np.arange(y0, y1, dtype=np.float32))
    positions = place(labels, data.landmarks, data.boundary)
    active = np.ones(len(labels), np.bool_)
    on_boundary = labels.curve == BOUNDARY  # a ray that met no skin has its sample at the centre
    reach = positions[on_boundary] - data.landmarks.axes.center
    active[on_boundary] = np.hypot(reach[:, 0], reach[:, 1]) > 1.0
    seen = see(data, labels, positions, width, height)
    return PlacedFace(data, labels, positions, active, x0, y0, alpha, seen)


def _occupied(data: FaceInFrame) -> Floats:
    """(4,) the part of the box where there is any matte, a cell around it included; it grows by some cells at once.

    The box has room for hair and a neck that may not be there; the lattice's nodes are better spent on skin.
    """
    raster, alpha = data.matte.raster, data.matte.alpha
    sides = []
    for axis in (0, 1):
        cells = np.flatnonzero(alpha.max(axis=axis))
        low = max(0, int(cells[0]) - 1) // _CELLS * _CELLS
        high = min(alpha.shape[1 - axis], -(-(int(cells[-1]) + 2) // _CELLS) * _CELLS)
        sides.append((raster.origin[axis] + low * raster.step, raster.origin[axis] + high * raster.step))
    (x0, x1), (y0, y1) = sides
    return np.array([x0, y0, x1, y1], np.float32)


def divide_overlaps(faces: Sequence[PlacedFace]) -> list[PlacedFace]:
    """The faces with their mattes divided where they overlap, so that no pixel is taken by more than 1 in all.

    Of two faces on one pixel it goes to the one within whose oval it lies, and to the larger one within both.
    """
    if not any(common(a.window, b.window) for k, a in enumerate(faces) for b in faces[:k]):
        return list(faces)
    claims = [face.alpha * _claim(face) for face in faces]
    out = []
    for face, claim in zip(faces, claims, strict=True):
        total = claim.copy()
        for other, others in zip(faces, claims, strict=True):
            shared = None if other is face else common(face.window, other.window)
            if shared is not None:
                total[slices_of(shared, (face.x, face.y))] += others[slices_of(shared, (other.x, other.y))]
        share = np.divide(claim, total, out=np.ones_like(claim), where=total > 0)
        out.append(replace(face, alpha=face.alpha * share))
    return out


def add_alpha(total: Floats, x: int, y: int, alpha: Floats) -> None:
    """Add alpha (h, w) at column x and row y to a whole picture's, in place; what lies beyond is dropped."""
    part = total[y : y + alpha.shape[0], x : x + alpha.shape[1]]
    part += alpha[: part.shape[0], : part.shape[1]]


def _claim(face: PlacedFace) -> Floats:
    """(h, w) how much a face's pixels belong to it rather than to a face behind or before it."""
    oval = np.zeros(face.alpha.shape, np.float32)
    corners = face.data.landmarks.oval - np.array([face.x, face.y], np.float32)
    cv2.fillPoly(oval, [fixed_point(corners)], 1.0, lineType=cv2.LINE_AA, shift=SUBPIXEL_BITS)
    width = max(face.data.landmarks.axes.width, 1.0)
    soft = cv2.GaussianBlur(oval, (0, 0), max(0.5, _OVAL_EDGE * width))
    return np.asarray((_BESIDE_OVAL + soft) * np.float32((width / 100.0) ** _NEARER), np.float32)
