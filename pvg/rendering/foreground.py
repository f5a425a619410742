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

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.raster import sites
from pvg.rendering import _foreground_kernels as kernels
from pvg.rendering._kernels import Grid
from pvg.rendering.plane_samples import at_chroma, over_chroma, without_fine_detail
from pvg.video import Frame, PixelFormat

_SURE = np.float32(0.97)  # of β, from which on a pixel is all skin [by eye]
_CELLS = 2  # of the matte to a cell of means
_SAMPLES = 4  # a side of such a cell that its mean is taken of, at least
_SPREAD = 1.0  # such cells, sigma of the mean [by eye: an edge is some cells wide]
_UNKNOWN = np.float32(-1e9)  # a mean that is read beside one is negative, by a share of it that is as small as 1/64 too
_HARDLY = np.float32(1e-4)  # of β, where there is any skin
_LEAST = np.float32(3e-4)  # of a mean's mass where all around is sure: with less there is none


@dataclass(frozen=True, eq=False)
class Foreground:
    """What the pixels of a matte's window show of skin, for any number of looks.

    planes: contiguous samples of the window;  alpha: the matte (h, w).
    """

    planes: tuple[NDArray[Any], ...]
    alpha: Floats
    format: PixelFormat

    @cached_property
    def chroma_alpha(self) -> Floats:
        """The matte over the samples of chroma, (r, c)."""
        return over_chroma(self.alpha, self.format)

    @cached_property
    def smooth(self) -> tuple[NDArray[Any], ...]:
        """The planes without fine detail, for what enlarges slopes."""
        log2x, _ = self.format.chroma_log2
        return tuple(without_fine_detail(plane, log2x if p else 0) for p, plane in enumerate(self.planes))

    @cached_property
    def luma_at_chroma(self) -> NDArray[Any]:
        """Smoothed luma where the samples of chroma are, (r, c)."""
        return at_chroma(self.smooth[0], self.format)


def foreground(frame: Frame, corner: tuple[int, int], alpha: Floats, step: float) -> Foreground:
    """Copies of the frame's planes over a matte's window, in which the pixels of its edge show the skin in them.

    corner: x, y of the window's first pixel, multiples of the chroma step;  alpha: (h, w) of the matte;
    step: pixels a cell of the matte.
    """
    shown = as_they_are(frame, corner, alpha)
    luma, *chroma = shown.planes
    beta = np.empty_like(alpha)
    kernels.least_around(alpha, _HARDLY, beta)
    _show_skin([luma], beta, step, 0)
    _show_skin(chroma, over_chroma(beta, frame.format), step, frame.format.chroma_log2[0])
    return shown


def as_they_are(frame: Frame, corner: tuple[int, int], alpha: Floats) -> Foreground:
    """The same without anything shown: copies of the planes over the window."""
    (x, y), (rows, columns) = corner, alpha.shape
    planes = (frame.over(p, (x, y, x + columns, y + rows)).copy() for p in range(3))
    return Foreground(tuple(planes), alpha, frame.format)


def _show_skin(parts: list[NDArray[Any]], beta: Floats, step: float, log2x: int) -> None:
    """Let samples (r, c) at the edge of a matte over them show the skin in them, in place.

    beta: (r, c) float32 β over the samples;  step: pixels a cell of the matte;  log2x: of the pixels along a sample.
    """
    rows, columns = beta.shape
    cell = max(2, round(_CELLS * step) >> log2x)
    apart = max(1, cell // _SAMPLES)
    cell = cell // apart * apart
    xs, ys = _in_cells(columns, cell), _in_cells(rows, cell)
    for part, mean in zip(parts, _means(parts, beta, cell, apart), strict=True):
        kernels.show_skin(part, beta, Grid(mean, xs, ys), _SURE)


def _means(parts: list[NDArray[Any]], beta: Floats, cell: int, apart: int) -> Iterator[Floats]:
    """The mean of the sure skin around each cell of `cell` samples a side, of each of some planes alike (r, c).

    beta: (r, c), see `_show_skin`;  apart: samples from one that is read to the next.
    """
    across = cell // apart
    rows, columns = (max(2, -(-size // cell)) for size in beta.shape)
    sparse = np.ascontiguousarray(beta[::apart, ::apart])
    mass: Floats | None = None
    for part in parts:
        sums = np.zeros((2, rows, columns), np.float32)
        few: NDArray[Any] = np.ascontiguousarray(part[::apart, ::apart])
        kernels.sum_sure(few, sparse, _SURE, across, sums)
        held = np.asarray(cv2.GaussianBlur(sums[0], (0, 0), _SPREAD), np.float32)
        if mass is None:  # the same for all of them
            mass = np.asarray(cv2.GaussianBlur(sums[1], (0, 0), _SPREAD), np.float32)
        kernels.known_means(held, mass, _LEAST * across * across, _UNKNOWN)
        yield held


def _in_cells(size: int, cell: int) -> Doubles:
    """Where the `size` samples of a side lie among cells of `cell` samples."""
    return sites(size, float(cell)).astype(np.float64)
