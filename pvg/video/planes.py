"""The picture of coded planes: windows of a frame, read and averaged in its own planes and only then made RGB."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bytes, Doubles, Floats
from pvg.picture import Affine, Box, clipped, halved, samples_a_cell
from pvg.raster import Raster, first_reading, scaled_affine
from pvg.video._kernels import Taps, average_cells, taps
from pvg.video.formats import Frame, PixelFormat, Plane, Planes


@dataclass(frozen=True, eq=False)
class PlanePicture:
    """A frame's planes, or a part of them, as a picture; see `pvg.picture.Picture`.

    corner: where the first luma pixel lies in the whole, a multiple of the chroma planes' subsampling;
    whole: (height, width). Reading gives the RGB of `PixelFormat.fast_rgb` within 2 levels, averages within 1.
    """

    format: PixelFormat
    planes: Planes
    corner: tuple[int, int]
    whole: tuple[int, int]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the whole picture."""
        return self.whole

    @property
    def box(self) -> Box:
        """x0, y0, x1, y1 of what is held."""
        x, y = self.corner
        return x, y, x + int(self.planes[0].shape[1]), y + int(self.planes[0].shape[0])

    def part(self, box: Box) -> PlanePicture:
        """See `Picture.part`; it begins at whole chroma samples and has one more all around."""
        (x, y), held = self.corner, self.box
        log2x, log2y = self.format.chroma_log2
        wide, high = 1 << log2x, 1 << log2y
        x0, y0, x1, y1 = clipped((box[0] - wide, box[1] - high, box[2] + wide, box[3] + high), held)
        x0, y0 = x0 - (x0 - x) % wide, y0 - (y0 - y) % high
        planes = [self.planes[0][y0 - y : y1 - y, x0 - x : x1 - x].copy()]
        across, down = slice((x0 - x) >> log2x, -(-(x1 - x) >> log2x)), slice((y0 - y) >> log2y, -(-(y1 - y) >> log2y))
        planes += [plane[down, across].copy() for plane in self.planes[1:]]
        return PlanePicture(self.format, (planes[0], planes[1], planes[2]), (x0, y0), self.whole)

    def rgb(self) -> Bytes:
        """See `Picture.rgb`."""
        return self.format.fast_rgb(self.planes)

    def thumbnail(self, size: tuple[int, int]) -> Bytes:
        """See `Picture.thumbnail`."""
        small = []
        for plane in self.planes:
            down, across = (max(1, plane.shape[axis] // (4 * size[1 - axis])) for axis in (0, 1))
            sparse: NDArray[Any] = np.ascontiguousarray(plane[::down, ::across])
            small.append(np.asarray(cv2.resize(sparse, size, interpolation=cv2.INTER_AREA)))
        return self._to_rgb(small[0], small[1], small[2])

    def reduced(self, reduction: float) -> tuple[PlanePicture, int]:
        """See `Picture.reduced`."""
        (log2x, log2y), factor = self.format.chroma_log2, 1
        luma, *chroma = self.planes
        while factor * 2 <= reduction and min(luma.shape) >= 2 << max(log2x, log2y):
            # whole chroma samples of the half-size picture only
            height, width = luma.shape[0] >> 1 + log2y, luma.shape[1] >> 1 + log2x
            luma = halved(luma[: height << 1 + log2y, : width << 1 + log2x])
            chroma = [halved(plane[: 2 * height, : 2 * width]) for plane in chroma]
            factor *= 2
        height, width = luma.shape
        return PlanePicture(self.format, (luma, chroma[0], chroma[1]), (0, 0), (height, width)), factor

    def warp(self, to_source: Affine, size: tuple[int, int]) -> Bytes:
        """See `Picture.warp`."""
        local = to_source.astype(np.float64)
        local[:, 2] -= self.corner
        log2x, log2y = self.format.chroma_log2
        fine = scaled_affine(local, np.array([0.5**log2x, 0.5**log2y]))
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        codes = [
            cv2.warpAffine(plane, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
            for plane, matrix in zip(self.planes, (local, fine, fine), strict=True)
        ]
        return self._to_rgb(codes[0], codes[1], codes[2])

    def cells(self, raster: Raster) -> Bytes:
        """See `Picture.cells`."""
        step, shape = raster.step, raster.shape
        corner, log2 = np.asarray(raster.origin, np.float64) - self.corner, self.format.chroma_log2
        luma = _averaged(self.planes[0], corner, (step, step), shape)
        # measured from the planes' edges, not from pixel centres, places and lengths simply scale
        place, sides = corner * 0.5 ** np.array(log2), (step / (1 << log2[0]), step / (1 << log2[1]))
        blue, red = _averaged(self.planes[1], place, sides, shape), _averaged(self.planes[2], place, sides, shape)
        return self._to_rgb(luma, blue, red)

    def _to_rgb(self, luma: NDArray[Any], blue: NDArray[Any], red: NDArray[Any]) -> Bytes:
        """(h, w, 3) RGB of planes (h, w) of one size, code values."""
        return self.format.shown(luma, blue, red)


def _averaged(plane: Plane, corner: Doubles, steps: tuple[float, float], shape: tuple[int, int]) -> Floats:
    """A plane over cells: corner (2,) x, y of the first one measured from the plane's own; steps along x and y."""
    x, y = (_weights(float(corner[axis]), steps[axis], shape[1 - axis], plane.shape[1 - axis]) for axis in (0, 1))
    out = np.empty(shape, np.float32)
    average_cells(plane, x, y, out)
    return out


def _weights(corner: float, step: float, count: int, samples: int) -> Taps:
    """The taps of `count` cells along one side of `samples`."""
    k = samples_a_cell(step)
    start, cells = np.empty(count, np.int32), np.empty(count, np.int32)
    return Taps(start, cells, taps(first_reading(corner, step / k), step, k, samples, start, cells))


def picture_of(frame: Frame) -> PlanePicture:
    """A frame as a picture; its planes are not copied."""
    return PlanePicture(frame.format, frame.planes, (0, 0), (frame.height, frame.width))
