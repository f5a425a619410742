"""The rest of a person's skin in one frame, ready to be drawn: its matte at pixel size.

The matte's edge follows the picture as the face's does (`pvg.rendering.edges`). Where the face's matte is, the body's
gives way,

    α_total = α_face + min(α_body, 1 − α_face) = min(1, α_face + α_body),

so that where both end softly towards each other nothing is lost between them, and no pixel takes more than one look.
A rim that is left along the face's edge and is thinner than the body's cells is dropped: the face's cells are smaller,
so that its edge is the finer one, and the rim would colour collars and walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Floats
from pvg.picture import Box, common, slices_of
from pvg.raster import Raster, block, square
from pvg.rendering._body_kernels import leave
from pvg.rendering.edges import EDGES, refine
from pvg.rendering.placed_face import PlacedFace
from pvg.skin import Matte
from pvg.video import Frame

_REACH = 2 * (EDGES.reach + 1)  # cells around the matte whose colours its edge is told by, even
_SOFT = 2  # cells beside the matte that its edge may lie in
_LEAST = 1e-3  # of alpha: less is nothing
_THIN, _BESIDE = 1.7, 2.0  # of the body's cells: a rim is thinner and lies as near to a face's matte [by eye]
_RIM = 25  # of a cell's alpha: a piece of which no cell has more, faces and rims aside, is dropped [by eye]
_WORTH = 40_000  # pixels whose work is about that of one window more [measured]
_MOST_PIECES = 64  # of a matte; a person's have some ten
_Labelled = tuple[tuple[int, ...], Box]  # components, and the box of the cells around


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """The matte of a person's other skin at pixel size, or of a piece of it.

    x, y: the source pixel of its corner, multiples of the chroma step;  alpha: (h, w) float32 in [0, 1];
    step: pixels a cell of the matte that it was read from.
    """

    x: int
    y: int
    alpha: Floats
    step: float

    @property
    def window(self) -> Box:
        """The box of its pixels in the picture."""
        return self.x, self.y, self.x + self.alpha.shape[1], self.y + self.alpha.shape[0]


def place_body(
    frame: Frame, body: Matte, faces: Sequence[PlacedFace], others: Sequence[PlacedBody]
) -> list[PlacedBody]:
    """A body's matte in the pixels of a frame, neck and hands apart where much of the frame lies between them.

    faces: all faces in the frame, which keep their own mattes;  others: bodies that were placed before.
    """
    placed = (_place_piece(frame, piece, faces, others) for piece in _pieces(body, faces))
    return [piece for piece in placed if piece is not None]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A part of a body's matte that touches no other.

    matte: over the cells whose colours its edge is told by, and one more around;
    cells: x, y, columns and rows of those of the body's that have any of it.
    """

    matte: Matte
    cells: tuple[int, int, int, int]


def _pieces(body: Matte, faces: Sequence[PlacedFace]) -> list[_Piece]:
    """A body's matte in pieces that are less work than the whole, without those that are rims of faces alone."""
    reached = cv2.dilate((body.alpha > 0).view(np.uint8), square(_REACH))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(reached, connectivity=8, ltype=cv2.CV_16U)
    beyond = _beyond(body, faces)
    counted = np.bincount(labels[beyond > _RIM], minlength=len(stats))
    boxes: list[_Labelled] = [
        ((k,), (x, y, x + w, y + h)) for k, (x, y, w, h, _) in enumerate(stats.tolist()) if k and counted[k]
    ]
    if len(boxes) > _MOST_PIECES:  # noise: what becomes of them all is less work than to tell which to join
        boxes = [(tuple(range(1, len(stats))), (0, 0, body.alpha.shape[1], body.alpha.shape[0]))]
    worth = _WORTH / body.raster.step**2
    pieces = []
    for which, box in _joined(boxes, worth):
        own = np.zeros(len(stats), np.bool_)
        own[list(which)] = True
        pieces.append(_piece(body, None if own[1:].all() else own, labels, _even(box, body.alpha.shape)))
    return pieces


def _piece(body: Matte, own: Bools | None, labels: NDArray[Any], box: Box) -> _Piece:
    """The components of a body's matte that `own` (n,) says, all when None, of those in a box of cells.

    labels: (rows, columns) of the components.
    """
    x0, y0 = box[:2]
    around = slices_of(box, (0, 0))
    alpha, mask = body.alpha[around], body.mask[around]
    if own is not None:
        kept = own[labels[around]]
        alpha, mask = np.where(kept, alpha, np.uint8(0)), mask & kept
    left, top, columns, rows = cv2.boundingRect(alpha)
    return _Piece(_part(body.raster, alpha, mask, (x0, y0)), (x0 + left, y0 + top, columns, rows))


def _beyond(body: Matte, faces: Sequence[PlacedFace]) -> Bytes:
    """(rows, columns) alpha of the body's cells beside the faces' mattes, without what is one cell wide."""
    xs, ys = (np.asarray(centers, np.float32) for centers in body.raster.centers())
    left = body.alpha.copy()
    for face in faces:
        raster = face.data.matte.raster
        x0, y0, x1, y1 = raster.box
        # a matte fades to nothing within a cell of its own around it
        columns, rows = (
            slice(*np.searchsorted(at, (low - raster.step, high + raster.step)).tolist())
            for at, low, high in ((xs, x0, x1), (ys, y0, y1))
        )
        part = left[rows, columns]
        if part.any():
            part[:] = cv2.subtract(part, _bytes(face.data.matte.alpha_at(xs[columns], ys[rows])))
    return np.asarray(cv2.morphologyEx(left, cv2.MORPH_OPEN, block(2)), np.uint8)


def _joined(boxes: list[_Labelled], worth: float) -> list[_Labelled]:
    """Boxes of components, joined as long as the box around two is at most `worth` larger than they."""
    for k, (which, box) in enumerate(boxes):
        for other, around in boxes[:k]:
            both = min(box[0], around[0]), min(box[1], around[1]), max(box[2], around[2]), max(box[3], around[3])
            if _area(both) <= _area(box) + _area(around) + worth:
                left = [each for each in boxes if each[0] not in (which, other)]
                return _joined([*left, (other + which, both)], worth)
    return boxes


def _area(box: Box) -> int:
    return (box[2] - box[0]) * (box[3] - box[1])


def _even(box: Box, shape: tuple[int, ...]) -> Box:
    """The box from even cells, so that an edge is told by the same blocks of cells wherever it begins; 2 cells wide."""
    x0, y0 = box[0] // 2 * 2, box[1] // 2 * 2
    return x0, y0, max(min(box[2], shape[1]), x0 + 2), max(min(box[3], shape[0]), y0 + 2)


def _place_piece(
    frame: Frame, piece: _Piece, faces: Sequence[PlacedFace], others: Sequence[PlacedBody]
) -> PlacedBody | None:
    """A piece in the pixels of a frame; None when nothing of it is left there."""
    align, step = frame.format.chroma_step, piece.matte.raster.step
    left, top, columns, rows = piece.cells
    x0, y0 = (max(0, int((low - _SOFT) * step) // align * align) for low in (left, top))
    x1, y1 = (
        min(size, -(-int(np.ceil((high + _SOFT) * step)) // align) * align)
        for high, size in ((left + columns, frame.width), (top + rows, frame.height))
    )
    if x1 <= x0 or y1 <= y0:
        return None
    alpha = piece.matte.alpha_at(np.arange(x0, x1, dtype=np.float32), np.arange(y0, y1, dtype=np.float32))
    refine(alpha, (x0, y0), piece.matte, frame)
    placed = PlacedBody(x0, y0, alpha, step)
    for face in faces:
        _take_out(placed, face)
    _take_rims_out(placed, faces)
    for other in others:
        _take_out(placed, other)
    return _cropped(placed, align)


def _cropped(body: PlacedBody, align: int) -> PlacedBody | None:
    """The body without empty rows and columns around it, from multiples of `align` on; None when all are."""
    left, top, columns, rows = cv2.boundingRect((body.alpha > _LEAST).view(np.uint8))
    if not rows:
        return None
    x, y = left // align * align, top // align * align
    alpha = body.alpha[y : -(-(top + rows) // align) * align, x : -(-(left + columns) // align) * align]
    return replace(body, x=body.x + x, y=body.y + y, alpha=np.ascontiguousarray(alpha))


def _take_rims_out(body: PlacedBody, faces: Sequence[PlacedFace]) -> None:
    """Leave out what lies along a face's matte and is thinner than a body's cells, in place: the finer edge holds."""
    beside, thin = (max(1, round(cells * body.step)) for cells in (_BESIDE, _THIN))
    for face in faces:
        left, top, right, bottom = face.window
        shared = common((left - beside, top - beside, right + beside, bottom + beside), body.window)
        if shared is None:
            continue
        part = body.alpha[slices_of(shared, (body.x, body.y))]
        held = _bytes(part)
        farther = cv2.copyMakeBorder(held, *(thin,) * 4, cv2.BORDER_REPLICATE)  # skin does not end with the picture
        opened = cv2.morphologyEx(farther, cv2.MORPH_OPEN, block(thin))[thin:-thin, thin:-thin]
        rims = cv2.subtract(held, opened)
        if not rims.any():
            continue
        around = cv2.dilate(_over(face, shared), square(beside))
        taken = cv2.multiply(around, rims, scale=1 / 255.0)
        part -= taken * np.float32(1 / 255.0)
        np.maximum(part, 0, out=part)


def _over(face: PlacedFace, box: Box) -> Bytes:
    """(h, w) the face's matte over a box of the picture's pixels, 0 beyond its window."""
    x0, y0, x1, y1 = box
    out = np.zeros((y1 - y0, x1 - x0), np.uint8)
    shared = common(box, face.window)
    if shared is not None:
        out[slices_of(shared, (x0, y0))] = _bytes(face.alpha[slices_of(shared, (face.x, face.y))])
    return out


def _bytes(alpha: NDArray[Any]) -> Bytes:
    return np.asarray(cv2.convertScaleAbs(alpha, alpha=255.0), np.uint8)


def _part(raster: Raster, alpha: Bytes, mask: Bools, first: tuple[int, int]) -> Matte:
    """A part of a matte, whose first cell is `first` (x, y) of its raster.

    It has one cell more around, the outermost repeated: skin does not end there.
    """
    wide, hard = (cv2.copyMakeBorder(held.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_REPLICATE) for held in (alpha, mask))
    origin = raster.origin + np.array([first[0] - 1, first[1] - 1], np.float32) * np.float32(raster.step)
    around = Raster(np.asarray(origin, np.float32), raster.step, (wide.shape[0], wide.shape[1]))
    return Matte(around, np.asarray(wide, np.uint8), hard.view(np.bool_))


def _take_out(body: PlacedBody, other: PlacedFace | PlacedBody) -> None:
    """Leave to another matte what it takes, in place."""
    shared = common(body.window, other.window)
    if shared is not None:
        x0, y0, x1, y1 = shared
        leave(body.alpha, (x0 - body.x, y0 - body.y), other.alpha, (x0 - other.x, y0 - other.y), (x1 - x0, y1 - y0))
