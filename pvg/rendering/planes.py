"""A look applied to the samples of one face: P' = P + alpha ((lambda - 1)(I - black - mean HF) + H), in any format.

The map is affine in every pixel, so it acts on the planes a clip is coded in. Only the rectangle of the face is
touched: the outcome are patches, which a writer lays over the frame it copies anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg.curves.labels import Floats, face_frame
from pvg.membrane.lattice import Membrane
from pvg.rendering import _planes as kernels
from pvg.rendering.placed_face import Region
from pvg.video import Frame, Patch, PixelFormat

_EYES = ((52, 53, 72, 54, 55, 56, 73, 57), (58, 59, 75, 60, 61, 62, 76, 63))
_INNER_LIPS = tuple(range(96, 104))
_FEATHER = 0.015  # of the face's width
_REACH = 3.0  # spreads of the feather after which next to nothing is left of it
_FINER = 4  # guards are drawn this many times finer than their cells
_CELLS_A_SPREAD = 2.0  # at least; so the guards of large faces are blurred on cells of several pixels
_FINE = 5  # pixels: side of the boxes that take fine detail out
_NO_GRID = np.empty((0, 0), np.float32)
_TOE, _KNEE = 0.05, 0.88  # of the way from black to white, where luma begins to roll off
_STRAIGHT = np.empty(0, np.float32)


@dataclass(frozen=True)
class Change:
    """Where a look's right-hand sides stand among a membrane's channels, and its lambda.

    channel: the first of three: luma and two of chroma, in the units of the frame's planes (of its opponent format);
    contrast: lambda;  contrast_channel: the first of two that hold lambda as a field, of luma and of chroma, or None;
    low_channel: the first of three that hold H(g), wanted with a `contrast` other than 1.
    """

    channel: int
    contrast: float = 1.0
    contrast_channel: int | None = None
    low_channel: int | None = None

    def gain_channel(self, plane: int) -> int | None:
        """The channel of lambda as a field for luma (plane 0) or chroma, None when lambda is a number."""
        return None if self.contrast_channel is None else self.contrast_channel + (plane > 0)

    def bend(self, pixel_format: PixelFormat, plane: int) -> Floats:
        """The roll-off of a plane, (4,) for `_planes.roll_off`, or (0,): luma has one where lambda is a field."""
        if plane > 0 or self.contrast_channel is None:
            return _STRAIGHT
        black = float(pixel_format.offset[0])
        span = float(pixel_format.matrix[0].sum()) * 255.0
        return np.array([black + _TOE * span, _TOE * span, black + _KNEE * span, (1 - _KNEE) * span], np.float32)


def _without_fine_detail(plane: NDArray[Any], log2: int = 0) -> NDArray[Any]:
    """A plane whose columns are 2^log2 pixels apart, smoothed by two boxes, nearly a bell; chroma at half size by one.

    A lambda above 1 as a field enlarges what is left: brows, lids and shades of skin go with the skin's brightness.
    Finer is noise as well, and single bright pixels beside lips and in the corners of eyes, which would turn white.
    """
    if log2:
        return cv2.blur(plane, (_FINE >> log2 | 1,) * 2)  # rounded once: chroma is nearly even, and twice would move it
    return cv2.blur(cv2.blur(plane, (_FINE, _FINE)), (_FINE, _FINE))


def protected_alpha(region: Region, protect: Sequence[str], *, in_place: bool = False) -> Floats:
    """The region's matte (h, w) without the features that keep their own colour ("eyes", "teeth").

    in_place: whether the region's own matte may be changed, for it is not wanted again.
    """
    points = region.data.points
    polygons: list[Floats] = []
    if "eyes" in protect:
        polygons += [points[list(eye)] for eye in _EYES]
    if "teeth" in protect:
        polygons.append(points[list(_INNER_LIPS)])
    if not polygons:
        return region.alpha
    sigma = max(0.8, _FEATHER * face_frame(points).width)
    origin = np.array([region.x, region.y], np.float32)
    alpha = region.alpha if in_place else region.alpha.copy()
    for polygon in polygons:
        _take_out(alpha, polygon - origin, sigma)
    return alpha


def _take_out(alpha: Floats, polygon: Floats, sigma: float) -> None:
    """Fade alpha to 0 inside a polygon of its pixels, over about `sigma` at its edge, in place."""
    cell = max(1, int(sigma / _CELLS_A_SPREAD))
    reach = int(np.ceil(_REACH * sigma / cell))
    x0, y0 = ((int(v) // cell - reach) * cell for v in np.floor(polygon.min(axis=0)))
    columns, rows = (
        int(v - low) // cell + reach + 1 for v, low in zip(np.ceil(polygon.max(axis=0)), (x0, y0), strict=True)
    )
    part = alpha[max(y0, 0) : max(y0 + rows * cell, 0), max(x0, 0) : max(x0 + columns * cell, 0)]
    if not part.size:
        return
    # The share of each cell that the polygon covers: the guard goes as lips and lids close. OpenCV draws every polygon
    # a pixel too wide, so that closed ones would keep a guard, and trembles; drawn finer, both are too small to see.
    finer = np.zeros((rows * _FINER, columns * _FINER), np.uint8)
    corners = (polygon - np.array([x0, y0], np.float32) + 0.5) * (_FINER / cell) - 0.5
    cv2.fillPoly(finer, [np.rint(corners * 16).astype(np.int32)], (255,), shift=4)
    covered = cv2.resize(finer, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32) / np.float32(255.0)
    side = 2 * reach + 1
    soft = cv2.GaussianBlur(covered, (side, side), sigma / cell, borderType=cv2.BORDER_CONSTANT)
    guard = soft if cell == 1 else cv2.resize(soft, (columns * cell, rows * cell), interpolation=cv2.INTER_LINEAR)
    top, left = max(-y0, 0), max(-x0, 0)
    part *= 1.0 - guard[top : top + part.shape[0], left : left + part.shape[1]]


def apply_change(
    frame: Frame,
    corner: tuple[int, int],
    alpha: Floats,
    membrane: Membrane,
    change: Change,
    under: Sequence[Patch] = (),
) -> list[Patch]:
    """The new samples of one face in every plane.

    corner: x, y of the source pixel that alpha (h, w) starts at, multiples of the chroma step;  alpha: the face's
    matte, guards taken out;  under: patches of other faces that were laid before.
    """
    if frame.format.is_rgb:
        return _apply_to_rgb(frame, corner, alpha, membrane, change, under)
    left, upper = corner
    pixel_format = frame.format
    top = np.float32(2**pixel_format.depth - 1)
    factor = np.float32(change.contrast - 1.0)
    patches = []
    over_chroma = _over_chroma(alpha, pixel_format)
    for p, plane in enumerate(frame.planes):
        log2 = pixel_format.chroma_log2 if p else (0, 0)
        weight = over_chroma if p else alpha
        rows, columns = weight.shape
        x, y = left >> log2[0], upper >> log2[1]
        before = plane[y : y + rows, x : x + columns]
        part = _with_patches(before, p, (x, y), under)
        places = _places(membrane, corner, (columns, rows), log2)
        level = float(pixel_format.offset[p])
        if change.contrast != 1.0 and change.low_channel is not None:
            # open skin is brighter than the curves around it, so HF has a mean; lambda leaves it where it is
            low = membrane.planes[change.low_channel + p]
            level = kernels.mean_above(before, weight, *places, low)
        shift, field = membrane.planes[change.channel + p], change.gain_channel(p)
        gain = _NO_GRID if field is None else membrane.planes[field]
        bend = change.bend(pixel_format, p)
        enlarges = field is not None and float(gain.max()) > 1.0
        # contiguous either way: one type, compiled once
        broad = _without_fine_detail(before, log2[0]) if enlarges else np.ascontiguousarray(before)
        zero = np.float32(level)
        kernels.apply_change(part, before, broad, weight, *places, shift, gain, factor, zero, bend, top)
        patches.append(Patch(p, y, x, part))
    return patches


def _over_chroma(alpha: Floats, pixel_format: PixelFormat) -> Floats:
    """The matte (h, w) averaged over the pixels of each chroma sample, as (r, c)."""
    log2x, log2y = pixel_format.chroma_log2
    if not (log2x or log2y):
        return alpha
    rows, columns = (-(-size // 2**log2) for size, log2 in zip(alpha.shape, (log2y, log2x), strict=True))
    out = np.empty((rows, columns), np.float32)
    kernels.block_means(alpha, log2x, log2y, out)
    return out


def _apply_to_rgb(
    frame: Frame, corner: tuple[int, int], alpha: Floats, membrane: Membrane, change: Change, under: Sequence[Patch]
) -> list[Patch]:
    """`apply_change` for R, G, B planes, as stills have: what luma and chroma gain is added in RGB."""
    (left, upper), (rows, columns) = corner, alpha.shape
    opponent = frame.format.opponent
    before = np.stack([plane[upper : upper + rows, left : left + columns] for plane in frame.planes], axis=-1)
    to_opponent = opponent.matrix @ np.linalg.inv(frame.format.matrix)
    source = (before @ to_opponent.T).astype(np.float32)
    wanted = source.copy()
    fields = np.moveaxis(membrane.crop(left, upper, columns, rows), -1, 0)
    for p in range(3):
        level, field = source[..., p], change.gain_channel(p)
        if field is not None:
            gain = fields[field] - 1.0
            wanted[..., p] += gain * np.where(gain > 0.0, _without_fine_detail(np.ascontiguousarray(level)), level)
        elif change.contrast != 1.0 and change.low_channel is not None:
            mean = np.average(level - fields[change.low_channel + p], weights=alpha)
            wanted[..., p] += (change.contrast - 1.0) * (level - np.float32(mean))
        wanted[..., p] += fields[change.channel + p]
        if p == 0:
            bend = change.bend(opponent, 0)
            if len(bend):
                wanted[..., 0], source[..., 0] = (kernels.roll_off(v, *bend) for v in (wanted[..., 0], source[..., 0]))
    gained = alpha[..., None] * ((wanted - source) @ np.linalg.inv(to_opponent).T)
    patches = []
    for p in range(3):
        part = _with_patches(before[..., p], p, corner, under)
        new = np.clip(np.rint(gained[..., p] + part), 0, 2**frame.format.depth - 1).astype(frame.format.dtype)
        patches.append(Patch(p, upper, left, new))
    return patches


def _with_patches(samples: NDArray[Any], plane: int, corner: tuple[int, int], patches: Sequence[Patch]) -> NDArray[Any]:
    """A copy of samples of a plane, the first of them at `corner` (x, y), with what the patches lay over them."""
    part = samples.copy()
    for patch in patches:
        if patch.plane == plane:
            _lay(part, corner, patch)
    return part


def _lay(part: NDArray[Any], corner: tuple[int, int], patch: Patch) -> None:
    """Copy what a patch shares with `part`, whose first sample is at `corner` (x, y), in place."""
    x, y = corner
    rows, columns = part.shape
    height, width = patch.samples.shape
    x0, x1 = max(x, patch.x), min(x + columns, patch.x + width)
    y0, y1 = max(y, patch.y), min(y + rows, patch.y + height)
    if x0 < x1 and y0 < y1:
        part[y0 - y : y1 - y, x0 - x : x1 - x] = patch.samples[y0 - patch.y : y1 - patch.y, x0 - patch.x : x1 - patch.x]


def _places(
    membrane: Membrane, corner: tuple[int, int], size: tuple[int, int], log2: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows of a plane's samples in the membrane's nodes.

    Chroma sits on the left luma column of its pair and between its rows, the default of H.264 and HEVC.
    """
    lattice = membrane.lattice
    columns = corner[0] + np.arange(size[0], dtype=np.float64) * 2.0 ** log2[0]
    rows = corner[1] + np.arange(size[1], dtype=np.float64) * 2.0 ** log2[1] + (2.0 ** log2[1] - 1) / 2
    return (columns - lattice.x) / lattice.step, (rows - lattice.y) / lattice.step
