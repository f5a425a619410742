"""The rest of a person's skin in one frame: its matte at pixel size, and the face's map F applied to it by tables.

The matte's edge follows the picture as the face's does (`pvg.rendering.edges`). Where the face's matte is, the body's
gives way,

    α_total = α_face + max(0, α_body − α_face) = max(α_face, α_body),

so that both may end softly within each other without a gap, and an edge that they share is not drawn twice. No curves
are needed: F takes luma by a table, and chroma by tables of luma,

    Y' = T(Y)        c' = m'(T(Y)) + k (c − m(Y))

with T of skin beside the face (`SkinMap.beside`). Slopes above 1 see a smoothed picture: what is finer is left as it
is, as in `planes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.raster import Raster
from pvg.rendering import _body_kernels as kernels
from pvg.rendering import _kernels
from pvg.rendering.edges import refine
from pvg.rendering.foreground import foreground
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_face import PlacedFace
from pvg.rendering.planes import luma_bend, opponent_matrix, over_chroma, with_patches, without_fine_detail
from pvg.skin import Matte
from pvg.skin.parameters import SKIN_PRIOR
from pvg.video import Frame, Patch

_REACH = 2 * (SKIN_PRIOR.edges.reach + 1)  # cells around the matte whose colours its edge is told by, even
_LEAST = 1e-3  # of alpha: less is nothing


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """The matte of a person's other skin at pixel size.

    x, y: the source pixel of its corner, multiples of the chroma step;  alpha: (h, w) float32 in [0, 1];
    step: pixels a cell of the matte that it was read from.
    """

    x: int
    y: int
    alpha: Floats
    step: float


def place_body(
    frame: Frame, body: Matte, faces: Sequence[PlacedFace], others: Sequence[PlacedBody]
) -> PlacedBody | None:
    """A body's matte in the pixels of a frame, None when there is nothing of it.

    faces: all faces in the frame, which keep their own mattes;  others: bodies that were placed before.
    """
    window = _window(frame, body)
    if window is None:
        return None
    x0, y0, x1, y1, cells = window
    matte = _part(body, cells)
    alpha = matte.alpha_at(np.arange(x0, x1, dtype=np.float32), np.arange(y0, y1, dtype=np.float32))
    refine(alpha, (x0, y0), matte, frame)
    placed = PlacedBody(x0, y0, alpha, matte.raster.step)
    for face in faces:
        _take_out(placed, face)
    for other in others:
        _take_out(placed, other)
    return placed if alpha.max(initial=0) > _LEAST else None


def _window(frame: Frame, body: Matte) -> tuple[int, int, int, int, tuple[int, int, int, int]] | None:
    """x0, y0, x1, y1 of the pixels that the matte may touch, and of its cells; None without any."""
    align = 2 ** max(frame.format.chroma_log2)
    pixels, cells = [], []
    for axis in (0, 1):
        held = np.flatnonzero(body.alpha.max(axis=axis))
        if not len(held):
            return None
        # from an even cell, so that an edge is told by the same blocks of cells wherever the window begins
        low = max(0, int(held[0]) // 2 * 2 - _REACH)
        high = min(body.alpha.shape[1 - axis], int(held[-1]) + 1 + _REACH)
        size = (frame.width, frame.height)[axis]
        step = body.raster.step
        pixels.append(
            (max(0, int(low * step) // align * align), min(size, -(-int(np.ceil(high * step)) // align) * align))
        )
        cells.append((low, max(high, low + 2)))
    (x0, x1), (y0, y1) = pixels
    if x1 <= x0 or y1 <= y0:
        return None
    return x0, y0, x1, y1, (cells[0][0], cells[1][0], cells[0][1], cells[1][1])


def _part(body: Matte, cells: tuple[int, int, int, int]) -> Matte:
    """The matte over the cells x0, y0, x1, y1 and one more around, the outermost repeated: skin does not end there."""
    x0, y0, x1, y1 = cells
    around = slice(y0, y1), slice(x0, x1)
    alpha, mask = np.pad(body.alpha[around], 1, mode="edge"), np.pad(body.mask[around], 1, mode="edge")
    step = body.raster.step
    origin = body.raster.origin + np.array([x0 - 1, y0 - 1], np.float32) * np.float32(step)
    return Matte(Raster(np.asarray(origin, np.float32), step, (alpha.shape[0], alpha.shape[1])), alpha, mask)


def _take_out(body: PlacedBody, other: PlacedFace | PlacedBody) -> None:
    """Leave to another matte what it takes, in place."""
    x0, y0 = max(body.x, other.x), max(body.y, other.y)
    x1 = min(body.x + body.alpha.shape[1], other.x + other.alpha.shape[1])
    y1 = min(body.y + body.alpha.shape[0], other.y + other.alpha.shape[0])
    if x0 < x1 and y0 < y1:
        part = body.alpha[y0 - body.y : y1 - body.y, x0 - body.x : x1 - body.x]
        taken = other.alpha[y0 - other.y : y1 - other.y, x0 - other.x : x1 - other.x]
        if isinstance(other, PlacedFace):
            np.maximum(part - taken, 0, out=part)
        else:
            np.minimum(part, 1 - taken, out=part)


def apply_body(frame: Frame, body: PlacedBody, tables: MapTables, under: Sequence[Patch] = ()) -> list[Patch]:
    """The new samples of a body in every plane;  under: patches that were laid before."""
    skin = foreground(frame, (body.x, body.y), body.alpha, body.step)
    if frame.format.is_rgb:
        return _apply_to_rgb(frame, body, skin, tables, under)
    pixel_format, (left, upper) = frame.format, (body.x, body.y)
    top = np.float32(2**pixel_format.depth - 1)
    h, w = body.alpha.shape
    luma = frame.planes[0][upper : upper + h, left : left + w]
    broad = without_fine_detail(skin[0])
    part = with_patches(luma, 0, (left, upper), under)
    kernels.apply_tone(part, skin[0], broad, body.alpha, tables.tone, luma_bend(pixel_format), top)
    patches = [Patch(0, upper, left, part)]
    log2x, log2y = pixel_format.chroma_log2
    weight = over_chroma(body.alpha, pixel_format)
    rows, columns = weight.shape
    x, y = left >> log2x, upper >> log2y
    for p in (1, 2):
        before = frame.planes[p][y : y + rows, x : x + columns]
        wide = without_fine_detail(skin[p], log2x) if tables.excess > 0 else skin[p]
        part = with_patches(before, p, (x, y), under)
        shift, excess = tables.chroma[p - 1], np.float32(tables.excess)
        kernels.apply_chroma(part, wide, broad, log2x, log2y, weight, shift, excess, top)
        patches.append(Patch(p, y, x, part))
    return patches


def _apply_to_rgb(
    frame: Frame, body: PlacedBody, skin: Sequence[NDArray[Any]], tables: MapTables, under: Sequence[Patch]
) -> list[Patch]:
    """`apply_body` for R, G, B planes: what luma and chroma gain is added in RGB."""
    (left, upper), (h, w) = (body.x, body.y), body.alpha.shape
    opponent = frame.format.opponent
    window = slice(upper, upper + h), slice(left, left + w)
    before: NDArray[Any] = np.stack([plane[window] for plane in frame.planes], axis=-1)
    to_opponent_codes = opponent_matrix(frame.format)
    source = (np.stack(skin, axis=-1) @ to_opponent_codes.T + opponent.offset).astype(np.float32)
    bend = luma_bend(opponent)
    luma: Floats = np.ascontiguousarray(source[..., 0])
    gained = tables.gained_of(source, without_fine_detail(source))
    gained[..., 0] = _kernels.roll_off(luma + gained[..., 0], bend) - _kernels.roll_off(luma, bend)
    change = body.alpha[..., None] * (gained @ np.linalg.inv(to_opponent_codes).T)
    patches = []
    for p in range(3):
        part = with_patches(before[..., p], p, (left, upper), under)
        new = np.clip(np.rint(change[..., p] + part), 0, 2**frame.format.depth - 1).astype(frame.format.dtype)
        patches.append(Patch(p, upper, left, new))
    return patches
