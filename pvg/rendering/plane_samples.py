"""What a correction needs of planes in any format: the roll-off, smoothed samples, the matte over chroma, patches."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.picture import common, slices_of
from pvg.rendering import _kernels as kernels
from pvg.rendering.guards import Guard
from pvg.video import Patch, PixelFormat

_FINE_PX = 5  # side of the boxes that take fine detail out [by eye: white specks go, brows and lids stay]
_TOE, _KNEE = 0.05, 0.88  # of the way from black to white, where luma begins to roll off [by eye]
_TINTED = np.float32(0.5)  # of the skin's change of chroma that eyes and teeth take [by eye: without, eyes look blue]


@lru_cache(maxsize=8)
def luma_bend(pixel_format: PixelFormat) -> Floats:
    """The roll-off of luma, (4,) for `_kernels.roll_off`."""
    black = float(pixel_format.offset[0])
    span = float(pixel_format.matrix[0].sum()) * 255.0
    return np.array([black + _TOE * span, _TOE * span, black + _KNEE * span, (1 - _KNEE) * span], np.float32)


def without_fine_detail(plane: NDArray[Any], log2: int = 0) -> NDArray[Any]:
    """A plane whose columns are 2^log2 pixels apart, smoothed by two boxes, nearly a bell; chroma at half size by one.

    Slopes of F above 1 enlarge what is left: brows, lids and shades of skin go with the skin's brightness. Finer is
    noise as well, and single bright pixels beside lips and in the corners of eyes, which would turn white.
    """
    if log2:
        return cv2.blur(plane, (_FINE_PX >> log2 | 1,) * 2)  # rounded once: chroma is nearly even, twice would move it
    return cv2.blur(cv2.blur(plane, (_FINE_PX, _FINE_PX)), (_FINE_PX, _FINE_PX))


def at_chroma(luma: NDArray[Any], pixel_format: PixelFormat) -> NDArray[Any]:
    """Luma (h, w) at the first pixel of each chroma sample, (r, c)."""
    log2x, log2y = pixel_format.chroma_log2
    return np.ascontiguousarray(luma[:: 1 << log2y, :: 1 << log2x])


def over_chroma(alpha: Floats, pixel_format: PixelFormat) -> Floats:
    """The matte (h, w) averaged over the pixels of each chroma sample, as (r, c)."""
    log2x, log2y = pixel_format.chroma_log2
    if not (log2x or log2y):
        return alpha
    rows, columns = (-(-size // 2**log2) for size, log2 in zip(alpha.shape, (log2y, log2x), strict=True))
    out = np.empty((rows, columns), np.float32)
    kernels.block_means(alpha, log2x, log2y, out)
    return out


class OverChroma:
    """`over_chroma` of a frame's weights, which must not change meanwhile: each averaged once for all looks."""

    def __init__(self, pixel_format: PixelFormat) -> None:
        self._format = pixel_format
        self._known: list[tuple[Floats, Floats]] = []

    def __call__(self, weight: Floats) -> Floats:
        """(r, c) of a weight (h, w)."""
        for known, averaged in self._known:
            if known is weight:
                return averaged
        self._known.append((weight, over_chroma(weight, self._format)))
        return self._known[-1][1]


def with_guards(weight: Floats, guards: Sequence[tuple[Guard, Floats]], pixel_format: PixelFormat) -> Floats:
    """The weight of chroma with a part of what guards took out: in warm light white is a little warm.

    guards: each with its weight over chroma.
    """
    out = weight.copy() if guards else weight
    log2x, log2y = pixel_format.chroma_log2
    for guard, over in guards:
        held = _TINTED * over
        top, left = guard.y >> log2y, guard.x >> log2x
        out[top : top + held.shape[0], left : left + held.shape[1]] += held
    return out


def with_patches(samples: NDArray[Any], plane: int, corner: tuple[int, int], patches: Sequence[Patch]) -> NDArray[Any]:
    """A copy of samples of a plane, the first of them at `corner` (x, y), with what the patches lay over them."""
    part = samples.copy()
    for patch in patches:
        if patch.plane == plane:
            _lay(part, corner, patch)
    return part


def _lay(part: NDArray[Any], corner: tuple[int, int], patch: Patch) -> None:
    """Copy what a patch shares with `part`, whose first sample is at `corner` (x, y), in place."""
    (x, y), (rows, columns), (height, width) = corner, part.shape, patch.samples.shape
    shared = common((x, y, x + columns, y + rows), (patch.x, patch.y, patch.x + width, patch.y + height))
    if shared is not None:
        part[slices_of(shared, corner)] = patch.samples[slices_of(shared, (patch.x, patch.y))]
