"""The rest of a person's skin in one frame: its matte at pixel size, and the face's map F applied to it by tables.

The coarse matte is sharpened by a guided filter whose coefficients are found on its own raster and read at pixel size:
α = a·Y + b, so the edge lies where the luma's edge is. Where the face's matte is, the body's gives way,

    α_total = α_face + max(0, α_body − α_face) = max(α_face, α_body),

so that both may end softly within each other without a gap, and an edge that they share is not drawn twice. No curves
are needed: F takes luma by a table, and chroma by tables of luma,

    Y' = T(Y)        c' = m'(T(Y)) + k (c − m(Y))

where slopes above 1 see a smoothed picture: what is finer is left as it is, as in `planes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.looks import BodyMap
from pvg.picture import halved
from pvg.raster import Raster, first_reading
from pvg.rendering import _body_kernels as kernels
from pvg.rendering import _kernels
from pvg.rendering.placed_face import PlacedFace
from pvg.rendering.planes import luma_bend, over_chroma, with_patches, without_fine_detail
from pvg.skin import Matte
from pvg.video import Frame, Patch, PixelFormat

_GUIDE_CELLS = 5  # side of the guided filter's boxes [by eye]
_GUIDE_EPSILON = 60.0  # squared 8-bit levels [by eye: less lets noise into the edge]
_MARGIN = np.float32(0.06)  # of alpha, cut off at both ends [by eye: no veil beside the skin]
_LEAST = 1e-3  # of alpha: less is nothing


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """The matte of a person's other skin at pixel size.

    x, y: the source pixel of its corner, multiples of the chroma step;  alpha: (h, w) float32 in [0, 1].
    """

    x: int
    y: int
    alpha: Floats


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
    raster = body.raster
    coarse = np.asarray(body.alpha[cells[1] : cells[3], cells[0] : cells[2]] / np.float32(255), np.float32)
    part = Raster(
        np.asarray(raster.origin + np.array(cells[:2], np.float32) * np.float32(raster.step), np.float32),
        raster.step,
        (coarse.shape[0], coarse.shape[1]),
    )
    luma = _luma(frame, (x0, y0, x1, y1))
    slope, start = _guide(coarse, _cell_means(luma, part.crop(np.array([x0, y0], np.float32))), frame.format.depth)
    columns, rows = (
        (np.arange(low, high) - part.origin[axis] + 0.5) / part.step - 0.5
        for axis, (low, high) in enumerate(((x0, x1), (y0, y1)))
    )
    alpha = np.empty(luma.shape, np.float32)
    kernels.guided_alpha(luma, slope, start, columns, rows, _MARGIN, alpha)
    placed = PlacedBody(x0, y0, alpha)
    for face in faces:
        _take_out(placed, face)
    for other in others:
        _take_out(placed, other)
    return placed if alpha.max(initial=0) > _LEAST else None


def _window(frame: Frame, body: Matte) -> tuple[int, int, int, int, tuple[int, int, int, int]] | None:
    """x0, y0, x1, y1 of the pixels that the matte may touch, and of its cells; None without any."""
    reach, align = _GUIDE_CELLS, 2 ** max(frame.format.chroma_log2)
    pixels, cells = [], []
    for axis in (0, 1):
        held = np.flatnonzero(body.alpha.max(axis=axis))
        if not len(held):
            return None
        low, high = max(0, int(held[0]) - reach), min(body.alpha.shape[1 - axis], int(held[-1]) + 1 + reach)
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


def _luma(frame: Frame, box: tuple[int, int, int, int]) -> NDArray[Any]:
    """(h, w) luma codes of a box of the frame."""
    x0, y0, x1, y1 = box
    if not frame.format.is_rgb:
        return np.ascontiguousarray(frame.planes[0][y0:y1, x0:x1])
    planes = np.stack([plane[y0:y1, x0:x1] for plane in frame.planes], axis=-1)
    weights = (frame.format.opponent.matrix @ np.linalg.inv(frame.format.matrix))[0]
    return np.asarray(np.rint(planes @ weights), frame.format.dtype)


def _cell_means(luma: NDArray[Any], raster: Raster) -> Floats:
    """Luma at a raster's cells, of its halved copies; raster: in luma's own pixels."""
    smaller, factor = luma, 1
    while factor * 2 <= raster.step and min(smaller.shape) >= 4:
        smaller, factor = halved(smaller), factor * 2
    step = raster.step / factor
    x, y = (first_reading(float(corner) / factor, step) for corner in raster.origin)
    matrix = np.array([[step, 0, x], [0, step, y]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (raster.shape[1], raster.shape[0])
    return np.asarray(cv2.warpAffine(smaller, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _guide(alpha: Floats, luma: Floats, depth: int) -> tuple[Floats, Floats]:
    """a, b (h, w) each of α = a·Y + b, the guided filter's coefficients; exactly 0 where alpha is 0 all around."""

    def mean(values: Floats) -> Floats:
        return np.asarray(cv2.blur(values, (_GUIDE_CELLS, _GUIDE_CELLS), borderType=cv2.BORDER_REPLICATE), np.float32)

    mean_luma, mean_alpha = mean(luma), mean(alpha)
    variance = np.maximum(mean(luma * luma) - mean_luma * mean_luma, 0)
    slope = (mean(luma * alpha) - mean_luma * mean_alpha) / (variance + np.float32(_GUIDE_EPSILON * 4.0 ** (depth - 8)))
    start = mean_alpha - slope * mean_luma
    near = cv2.dilate((alpha > 0).astype(np.uint8), np.ones((_GUIDE_CELLS, _GUIDE_CELLS), np.uint8)).astype(np.float32)
    slopes, starts = (np.asarray(cv2.blur(values, (3, 3)), np.float32) * near for values in (slope, start))
    return slopes, starts


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


@dataclass(frozen=True, eq=False)
class BodyTables:
    """A map F on the planes of one format, strength applied.

    tone: (2, n) float32 what luma gains by its code, by slopes of T above 1 and below;
    chroma: (2, n) float32 what each chroma plane gains by luma's code, `excess` of its own code aside.
    """

    tone: Floats
    chroma: Floats
    excess: float

    @classmethod
    def of(cls, look: BodyMap, pixel_format: PixelFormat, gain: float = 1.0, kept: float = 1.0) -> BodyTables:
        """The tables of a look for the opponent planes of a format;  gain, kept: see `BodyMap.exposures`."""
        opponent = pixel_format.opponent
        usual, goal = look.usual_colors()
        source, target = (colors @ opponent.matrix.T + opponent.offset for colors in (gain * usual, kept * goal))
        codes = np.arange(2.0**pixel_format.depth)
        gained = _read(codes, source[:, 0], target[:, 0] - source[:, 0])
        slopes = np.diff(gained, prepend=gained[0])
        middle = int(np.argmin(np.abs(codes - source[128, 0])))
        summed = np.cumsum(np.maximum(slopes, 0))
        rise = summed - summed[middle]
        fall = gained - rise
        excess = look.strength * (look.skin.spread * kept / gain - 1.0)
        chroma = [
            look.strength * _read(codes, source[:, 0], target[:, p] - source[:, p])
            - excess * _read(codes, source[:, 0], source[:, p])
            for p in (1, 2)
        ]
        tone = look.strength * np.stack([rise, fall])
        return cls(tone.astype(np.float32), np.stack(chroma).astype(np.float32), float(excess))


def _read(codes: Doubles, at: Doubles, values: Doubles) -> Doubles:
    """Values (n,) known at increasing `at` (n,), read at `codes`; constant beyond."""
    return np.asarray(np.interp(codes, np.maximum.accumulate(at), values))


def apply_body(frame: Frame, body: PlacedBody, tables: BodyTables, under: Sequence[Patch] = ()) -> list[Patch]:
    """The new samples of a body in every plane;  under: patches that were laid before."""
    if frame.format.is_rgb:
        return _apply_to_rgb(frame, body, tables, under)
    pixel_format, (left, upper) = frame.format, (body.x, body.y)
    top = np.float32(2**pixel_format.depth - 1)
    h, w = body.alpha.shape
    luma = frame.planes[0][upper : upper + h, left : left + w]
    broad = without_fine_detail(luma)
    part = with_patches(luma, 0, (left, upper), under)
    kernels.apply_tone(part, luma, broad, body.alpha, tables.tone, luma_bend(pixel_format), top)
    patches = [Patch(0, upper, left, part)]
    log2x, log2y = pixel_format.chroma_log2
    weight = over_chroma(body.alpha, pixel_format)
    rows, columns = weight.shape
    x, y = left >> log2x, upper >> log2y
    for p in (1, 2):
        before = frame.planes[p][y : y + rows, x : x + columns]
        wide: NDArray[Any] = without_fine_detail(before, log2x) if tables.excess > 0 else np.ascontiguousarray(before)
        part = with_patches(before, p, (x, y), under)
        shift, excess = tables.chroma[p - 1], np.float32(tables.excess)
        kernels.apply_chroma(part, wide, broad, log2x, log2y, weight, shift, excess, top)
        patches.append(Patch(p, y, x, part))
    return patches


def _apply_to_rgb(frame: Frame, body: PlacedBody, tables: BodyTables, under: Sequence[Patch]) -> list[Patch]:
    """`apply_body` for R, G, B planes: what luma and chroma gain is added in RGB."""
    (left, upper), (h, w) = (body.x, body.y), body.alpha.shape
    opponent = frame.format.opponent
    window = slice(upper, upper + h), slice(left, left + w)
    before: NDArray[Any] = np.stack([plane[window] for plane in frame.planes], axis=-1)
    to_opponent_codes = opponent.matrix @ np.linalg.inv(frame.format.matrix)
    source = (before @ to_opponent_codes.T + opponent.offset).astype(np.float32)
    broad = [without_fine_detail(np.ascontiguousarray(source[..., p])) for p in range(3)]
    codes = np.arange(tables.tone.shape[1], dtype=np.float32)
    rise, fall = tables.tone
    bend = luma_bend(opponent)
    luma: Floats = np.ascontiguousarray(source[..., 0])
    wanted = luma + np.interp(broad[0], codes, rise) + np.interp(luma, codes, fall)
    gained = np.empty_like(source)
    gained[..., 0] = _kernels.roll_off(np.asarray(wanted, np.float32), bend) - _kernels.roll_off(luma, bend)
    for p in (1, 2):
        wide = broad[p] if tables.excess > 0 else source[..., p]
        gained[..., p] = np.interp(broad[0], codes, tables.chroma[p - 1]) + tables.excess * wide
    change = body.alpha[..., None] * (gained @ np.linalg.inv(to_opponent_codes).T)
    patches = []
    for p in range(3):
        part = with_patches(before[..., p], p, (left, upper), under)
        new = np.clip(np.rint(change[..., p] + part), 0, 2**frame.format.depth - 1).astype(frame.format.dtype)
        patches.append(Patch(p, upper, left, new))
    return patches
