"""A correction applied to the samples of one face, in any coded format.

    P' = P + α (R(P + (λ − 1)(P − level) + H(g' − λg)) − R(P))

with the roll-off R towards black and white. The correction is affine in every pixel, so it acts on the planes a clip
is coded in. Only the rectangle of the face is touched: the outcome are patches, which a writer lays over the frame it
copies anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.membrane import Lattice, Membrane
from pvg.raster import sites
from pvg.rendering import _kernels as kernels
from pvg.rendering.correction import Correction
from pvg.video import Frame, Patch, PixelFormat

_FINE_PX = 5  # side of the boxes that take fine detail out [by eye: white specks go, brows and lids stay]
_TOE, _KNEE = 0.05, 0.88  # of the way from black to white, where luma begins to roll off [by eye]
_NO_FIELD = np.empty((0, 0), np.float32)
_NO_ROLL_OFF = np.empty(0, np.float32)


def _roll_off(correction: Correction, pixel_format: PixelFormat, plane: int) -> Floats:
    """The roll-off of a plane, (4,) for `_kernels.roll_off`, or (0,): luma has one where λ is a field."""
    return _NO_ROLL_OFF if plane > 0 or correction.contrast_field(plane) is None else luma_bend(pixel_format)


def luma_bend(pixel_format: PixelFormat) -> Floats:
    """The roll-off of luma, (4,) for `_kernels.roll_off`."""
    black = float(pixel_format.offset[0])
    span = float(pixel_format.matrix[0].sum()) * 255.0
    return np.array([black + _TOE * span, _TOE * span, black + _KNEE * span, (1 - _KNEE) * span], np.float32)


def without_fine_detail(plane: NDArray[Any], log2: int = 0) -> NDArray[Any]:
    """A plane whose columns are 2^log2 pixels apart, smoothed by two boxes, nearly a bell; chroma at half size by one.

    A field λ above 1 enlarges what is left: brows, lids and shades of skin go with the skin's brightness. Finer is
    noise as well, and single bright pixels beside lips and in the corners of eyes, which would turn white.
    """
    if log2:
        return cv2.blur(plane, (_FINE_PX >> log2 | 1,) * 2)  # rounded once: chroma is nearly even, twice would move it
    return cv2.blur(cv2.blur(plane, (_FINE_PX, _FINE_PX)), (_FINE_PX, _FINE_PX))


def apply_correction(
    frame: Frame, corner: tuple[int, int], alpha: Floats, correction: Correction, under: Sequence[Patch] = ()
) -> list[Patch]:
    """The new samples of one face in every plane.

    corner: x, y of the source pixel that alpha (h, w) starts at, multiples of the chroma step;  alpha: the face's
    matte, guards taken out;  under: patches of other faces that were laid before.
    """
    if frame.format.is_rgb:
        return _apply_to_rgb(frame, corner, alpha, correction, under)
    left, upper = corner
    pixel_format = frame.format
    top = np.float32(2**pixel_format.depth - 1)
    patches = []
    chroma_alpha = over_chroma(alpha, pixel_format)
    for p, plane in enumerate(frame.planes):
        log2 = pixel_format.chroma_log2 if p else (0, 0)
        weight = chroma_alpha if p else alpha
        rows, columns = weight.shape
        x, y = left >> log2[0], upper >> log2[1]
        before = plane[y : y + rows, x : x + columns]
        part = with_patches(before, p, (x, y), under)
        places = _places(correction.lattice, corner, (columns, rows), log2)
        level = float(pixel_format.offset[p])
        if correction.low is not None and correction.contrast_number != 1.0:
            # open skin is brighter than the curves around it, so I − H(g) has a mean; λ leaves it where it is
            level = kernels.mean_above(before, weight, *places, correction.low[p])
        field = correction.contrast_field(p)
        enlarges = field is not None and float(field.max()) > 1.0
        # contiguous either way: one type, compiled once
        broad: NDArray[Any] = without_fine_detail(before, log2[0]) if enlarges else np.ascontiguousarray(before)
        kernels.apply_correction(
            part,
            before,
            broad,
            weight,
            *places,
            correction.shift[p],
            _NO_FIELD if field is None else field,
            np.float32(correction.contrast_number - 1.0),
            np.float32(level),
            _roll_off(correction, pixel_format, p),
            top,
        )
        patches.append(Patch(p, y, x, part))
    return patches


def over_chroma(alpha: Floats, pixel_format: PixelFormat) -> Floats:
    """The matte (h, w) averaged over the pixels of each chroma sample, as (r, c)."""
    log2x, log2y = pixel_format.chroma_log2
    if not (log2x or log2y):
        return alpha
    rows, columns = (-(-size // 2**log2) for size, log2 in zip(alpha.shape, (log2y, log2x), strict=True))
    out = np.empty((rows, columns), np.float32)
    kernels.block_means(alpha, log2x, log2y, out)
    return out


def _apply_to_rgb(
    frame: Frame, corner: tuple[int, int], alpha: Floats, correction: Correction, under: Sequence[Patch]
) -> list[Patch]:
    """`apply_correction` for R, G, B planes, as stills have: what luma and chroma gain is added in RGB."""
    (left, upper), (rows, columns) = corner, alpha.shape
    opponent = frame.format.opponent
    before = np.stack([plane[upper : upper + rows, left : left + columns] for plane in frame.planes], axis=-1)
    to_opponent = opponent.matrix @ np.linalg.inv(frame.format.matrix)
    source = (before @ to_opponent.T).astype(np.float32)
    wanted = source.copy()

    def over_pixels(nodes: Floats) -> Floats:
        return Membrane(correction.lattice, nodes[None]).crop(left, upper, columns, rows)[..., 0]

    for p in range(3):
        plane, field = source[..., p], correction.contrast_field(p)
        if field is not None:
            excess = over_pixels(field) - 1.0
            wanted[..., p] += excess * np.where(excess > 0.0, without_fine_detail(np.ascontiguousarray(plane)), plane)
        elif correction.low is not None and correction.contrast_number != 1.0:
            mean = np.average(plane - over_pixels(correction.low[p]), weights=alpha)
            wanted[..., p] += (correction.contrast_number - 1.0) * (plane - np.float32(mean))
        wanted[..., p] += over_pixels(correction.shift[p])
        if p == 0:
            bend = _roll_off(correction, opponent, 0)
            if len(bend):
                wanted[..., 0], source[..., 0] = (kernels.roll_off(v, bend) for v in (wanted[..., 0], source[..., 0]))
    gained = alpha[..., None] * ((wanted - source) @ np.linalg.inv(to_opponent).T)
    patches = []
    for p in range(3):
        part = with_patches(before[..., p], p, corner, under)
        new = np.clip(np.rint(gained[..., p] + part), 0, 2**frame.format.depth - 1).astype(frame.format.dtype)
        patches.append(Patch(p, upper, left, new))
    return patches


def with_patches(samples: NDArray[Any], plane: int, corner: tuple[int, int], patches: Sequence[Patch]) -> NDArray[Any]:
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
    lattice: Lattice, corner: tuple[int, int], size: tuple[int, int], log2: tuple[int, int]
) -> tuple[Doubles, Doubles]:
    """Columns and rows of a plane's samples in the lattice's nodes.

    Chroma sits on the left luma column of its pair and between its rows, the default of H.264 and HEVC.
    """
    columns = corner[0] + np.arange(size[0], dtype=np.float64) * 2.0 ** log2[0]
    rows = corner[1] + sites(size[1], 0.5 ** log2[1]).astype(np.float64)
    return (columns - lattice.x) / lattice.step, (rows - lattice.y) / lattice.step
