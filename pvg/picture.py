"""Pictures looked at through windows: only what is looked at is read, averaged and converted to RGB.

A face fills a tenth of a frame, and the networks and the skin want it small, so converting whole frames would cost
more than all that is done with them. `RgbPicture` is the picture of an array; `pvg.video` has one of coded planes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bytes, Doubles, Floats
from pvg.raster import Raster, first_reading

Affine = Doubles
Box = tuple[int, int, int, int]

SUPERSAMPLE = 6
LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of R, G and B in luma [Rec. 601]."""
_DARK = 1.0  # level of a mean that a deviation is divided by, at least
_USUAL_SKIN = np.array([14.0, 18.0])  # a* and b*, about [by eye]


def rms_contrast(luma: Floats | Bytes) -> float:
    """The deviation of a picture's luma (h, w), 0-255, over its mean."""
    mean, deviation = cv2.meanStdDev(luma)
    return float(deviation[0, 0]) / max(float(mean[0, 0]), _DARK)


def median_lab(colors: Floats) -> Doubles:
    """(3,) CIELAB of the median of colours (n, 3), 0-255 RGB."""
    median = (np.median(colors, axis=0) / 255.0).astype(np.float32)
    return np.asarray(cv2.cvtColor(median.reshape(1, 1, 3), cv2.COLOR_RGB2LAB)[0, 0], np.float64)


def off_usual_skin(lab: Doubles) -> float:
    """How far the chroma of a colour (3,) CIELAB lies from what skin has in usual light, in its units."""
    return float(np.hypot(*(lab[1:] - _USUAL_SKIN)))


class Picture(Protocol):
    """A picture, or the part of one that was kept; coordinates are always those of the whole.

    What is asked for beyond it repeats its edge.
    """

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the whole picture."""

    @property
    def box(self) -> Box:
        """x0, y0, x1, y1 of what is held, pixels x0 … x1 − 1."""

    def part(self, box: Box) -> Picture:
        """A copy of what is held within the box, perhaps a pixel more; at least one pixel."""

    def rgb(self) -> Bytes:
        """All that is held, (h, w, 3) uint8 RGB: its first pixel lies at the box's x0, y0."""

    def thumbnail(self, size: tuple[int, int]) -> Bytes:
        """What is held at a small size (w, h), (h, w, 3) uint8 RGB, averaged from some of its pixels."""

    def reduced(self, reduction: float) -> tuple[Picture, int]:
        """What is held as a picture of its own, 2×2 pixels averaged as often as `reduction` allows, and the factor.

        Pixel p of it covers the pixels factor·p … factor·p + factor − 1 from the box's corner on. An odd last row or
        column is dropped.
        """

    def warp(self, to_source: Affine, size: tuple[int, int]) -> Bytes:
        """(h, w, 3) uint8 RGB for size (w, h): pixel (x, y) is read bilinearly at to_source (2, 3) · (x, y, 1)."""

    def cells(self, raster: Raster) -> Bytes:
        """The picture averaged over the cells of a raster: (h, w, 3) uint8 RGB."""


def samples_a_cell(step: float) -> int:
    """How many points a side a cell of `step` pixels is averaged from."""
    return min(SUPERSAMPLE, max(1, int(np.ceil(step - 0.25))))


def halved(plane: NDArray[Any]) -> NDArray[Any]:
    """2×2 pixels averaged; an odd last row or column is dropped.

    Ten times as fast as one cv2.INTER_AREA step to any size, whose compiled path takes exact halves only.
    """
    height, width = (size // 2 for size in plane.shape[:2])
    return np.asarray(cv2.resize(plane[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))


def clipped(box: Box, within: Box) -> Box:
    """The common part of two boxes, at least the one pixel of `within` nearest to it."""
    x0, y0 = min(max(box[0], within[0]), within[2] - 1), min(max(box[1], within[1]), within[3] - 1)
    x1, y1 = max(min(box[2], within[2]), x0 + 1), max(min(box[3], within[3]), y0 + 1)
    return x0, y0, x1, y1


def common(one: Box, other: Box) -> Box | None:
    """The common part of two boxes; None where they have none."""
    x0, y0 = max(one[0], other[0]), max(one[1], other[1])
    x1, y1 = min(one[2], other[2]), min(one[3], other[3])
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def slices_of(box: Box, corner: tuple[int, int]) -> tuple[slice, slice]:
    """The rows and columns of a box in an array whose first pixel lies at `corner` (x, y)."""
    x, y = corner
    return slice(box[1] - y, box[3] - y), slice(box[0] - x, box[2] - x)


@dataclass(frozen=True, eq=False)
class RgbPicture:
    """The picture of an RGB array.

    pixels: (h, w, 3) uint8;  corner: where its first pixel lies in the whole;  whole: (height, width), its own if None.
    """

    pixels: Bytes
    corner: tuple[int, int] = (0, 0)
    whole: tuple[int, int] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the whole picture."""
        return self.whole or (int(self.pixels.shape[0]), int(self.pixels.shape[1]))

    @property
    def box(self) -> Box:
        """x0, y0, x1, y1 of what is held."""
        x, y = self.corner
        return x, y, x + int(self.pixels.shape[1]), y + int(self.pixels.shape[0])

    def part(self, box: Box) -> RgbPicture:
        """See `Picture.part`."""
        kept = clipped(box, self.box)
        return RgbPicture(self.pixels[slices_of(kept, self.corner)].copy(), kept[:2], self.size)

    def rgb(self) -> Bytes:
        """See `Picture.rgb`."""
        return self.pixels

    def thumbnail(self, size: tuple[int, int]) -> Bytes:
        """See `Picture.thumbnail`."""
        # every k-th pixel first: averaging a whole large frame would cost more than fitting a face
        step = max(1, min(self.pixels.shape[0] // (4 * size[1]), self.pixels.shape[1] // (4 * size[0])))
        sparse = np.ascontiguousarray(self.pixels[::step, ::step])
        return np.asarray(cv2.resize(sparse, size, interpolation=cv2.INTER_AREA), np.uint8)

    def reduced(self, reduction: float) -> tuple[RgbPicture, int]:
        """See `Picture.reduced`."""
        pixels, factor = self.pixels, 1
        while factor * 2 <= reduction and min(pixels.shape[:2]) >= 2:
            pixels, factor = np.asarray(halved(pixels), np.uint8), factor * 2
        return RgbPicture(pixels), factor

    def warp(self, to_source: Affine, size: tuple[int, int]) -> Bytes:
        """See `Picture.warp`."""
        matrix = to_source.astype(np.float64)
        matrix[:, 2] -= self.corner
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        out = cv2.warpAffine(self.pixels, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(out, np.uint8)

    def cells(self, raster: Raster) -> Bytes:
        """See `Picture.cells`."""
        h, w = raster.shape
        k = samples_a_cell(raster.step)
        fine = raster.step / k
        x, y = (first_reading(float(corner), fine) for corner in raster.origin)
        part = self.warp(np.array([[fine, 0, x], [0, fine, y]]), (w * k, h * k))
        return part if k == 1 else np.asarray(cv2.resize(part, (w, h), interpolation=cv2.INTER_AREA), np.uint8)


def cut_out(picture: Picture, box: Floats) -> tuple[Bytes, Floats]:
    """What a picture holds in a box (4,) x0, y0, x1, y1 and two pixels around: (h, w, 3) uint8, and where it begins.

    That is (2,) float32, the x and y of its first pixel.
    """
    x0, y0, x1, y1 = (int(v) for v in box)
    part = picture.part((x0 - 2, y0 - 2, x1 + 3, y1 + 3))
    return part.rgb(), np.array(part.box[:2], np.float32)


def as_picture(picture: Picture | Bytes) -> Picture:
    """An array (H, W, 3) uint8 RGB as a picture; a picture as it is."""
    return RgbPicture(np.ascontiguousarray(picture)) if isinstance(picture, np.ndarray) else picture
