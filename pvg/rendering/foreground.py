"""What the pixels at a matte's edge show of skin: their foreground, as matting calls it.

A pixel at the edge is a mixture of skin and of hair, wall or collar, I = α S + (1 − α) B, and only the skin in it takes
a look,

    I' = I + α (u'(S) − S)

A look's map of colour is not linear, so it must be read at S. Read at I, skin between the hairs of a fringe would stay
as it was beside a face made bright, and what is brighter than the skin in front of it would shine.
S is not known where α is small; there the mean of the sure skin nearby stands for it:

    S ≈ β² I + (1 − β²) mean

with β the least α among a pixel and those around it: lenses and codecs mix neighbours, so the outermost pixel of sure
skin holds some of B, and a map that brightens skin would draw a rim of it. S is I deeper inside and outside of the
matte, and where no sure skin is near.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.raster import sites
from pvg.rendering import _kernels as kernels
from pvg.rendering.plane_samples import over_chroma
from pvg.video import Frame

_SURE = np.float32(0.97)  # of alpha, from which on a pixel is all skin [by eye]
_CELLS = 2  # of the matte to a cell of means
_SAMPLES = 4  # a side of such a cell that its mean is taken of, at least
_SPREAD = 1.0  # such cells, sigma of the mean [by eye: an edge is some cells wide]
_UNKNOWN = np.float32(-1e9)  # a mean that is read beside one is negative, by a share of it that is as small as 1/64 too
_NEIGHBOURS = np.ones((3, 3), np.uint8)
_HARDLY = np.float32(1e-4)  # of β, where there is any skin
_LEAST = np.float32(3e-4)  # of a mean's weight where all around is sure: with less there is none


def foreground(frame: Frame, corner: tuple[int, int], alpha: Floats, step: float) -> tuple[NDArray[Any], ...]:
    """Copies of the frame's planes over a matte's window, in which the pixels of its edge show the skin in them.

    corner: x, y of the window's first pixel, multiples of the chroma step;  alpha: (h, w) of the matte;
    step: pixels a cell of the matte.
    """
    left, upper = corner
    out = []
    alpha = np.maximum(cv2.erode(alpha, _NEIGHBOURS), np.minimum(alpha, _HARDLY))
    chroma_alpha = over_chroma(alpha, frame.format)
    for p, plane in enumerate(frame.planes[:3]):
        log2x, log2y = (0, 0) if p == 0 or frame.format.is_rgb else frame.format.chroma_log2
        weight = chroma_alpha if p else alpha
        (rows, columns), x, y = weight.shape, left >> log2x, upper >> log2y
        part = plane[y : y + rows, x : x + columns].copy()
        cell = max(2, round(_CELLS * step) >> log2x)
        apart = max(1, cell // _SAMPLES)
        across = cell // apart
        cell = across * apart
        sums = np.zeros((2, max(2, -(-rows // cell)), max(2, -(-columns // cell))), np.float32)
        few: NDArray[Any] = np.ascontiguousarray(part[::apart, ::apart])
        kernels.sum_sure(few, np.ascontiguousarray(weight[::apart, ::apart]), _SURE, across, sums)
        held, mass = (cv2.GaussianBlur(each, (0, 0), _SPREAD) for each in sums)
        mean = np.where(mass > _LEAST * across * across, held / np.maximum(mass, np.float32(1e-6)), _UNKNOWN)
        kernels.show_skin(part, weight, _in_cells(columns, cell), _in_cells(rows, cell), mean, _SURE)
        out.append(part)
    return tuple(out)


def _in_cells(size: int, cell: int) -> Doubles:
    """Where the `size` samples of a side lie among cells of `cell` samples."""
    return sites(size, float(cell)).astype(np.float64)
