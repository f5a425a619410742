"""Rasters over pictures, and the one place that knows about half pixels.

Coordinates count pixel centres: pixel (0, 0) is centred at the origin and reaches from −½ to ½. Whatever has another
size or another corner than the picture (a crop, a smaller copy, the cells of a matte) is a `Raster`, and nobody else
adds or takes away a half. Compiled kernels take the same formulas from here: `cell_center`, `cell_middle`, `cell_at`,
`on_copy`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Doubles, Floats, Reals
from pvg._bilinear import read_grid
from pvg._compiled import kernel

SUBPIXEL_BITS = 4


def _cell_center(corner: Any, step: float, cell: Any) -> Any:
    """The position of the centre of a raster's cell, along one side."""
    return corner + (cell + 0.5) * step - 0.5


def _cell_middle(corner: Any, step: float, cell: Any) -> Any:
    """How far the centre of a raster's cell is from the picture's own corner, along one side; see `to_edge`."""
    return corner + (cell + 0.5) * step


def _cell_at(corner: Any, step: float, place: Any) -> Any:
    """The cell of a raster, along one side, whose centre is at a position."""
    return (place - corner + 0.5) / step - 0.5


def _on_copy(place: Any, ratio: Any) -> Any:
    """A position of a picture in a copy of it whose sides are `ratio` times as long."""
    return (place + 0.5) * ratio - 0.5


cell_center = kernel(inline=True)(_cell_center)
cell_middle = kernel(inline=True)(_cell_middle)
cell_at = kernel(inline=True)(_cell_at)
on_copy = kernel(inline=True)(_on_copy)


@dataclass(frozen=True, eq=False)
class Raster:
    """Square cells over a part of a picture.

    origin: (2,) x, y of the pixel whose own corner is the raster's;  step: source pixels a cell;
    shape: (rows, columns). Cell (r, c) reaches from origin − ½ + step·(c, r) on and its centre lies half a step
    further.
    """

    origin: Floats
    step: float
    shape: tuple[int, int]

    @classmethod
    def centered(cls, box: Floats, step: float, shape: tuple[int, int]) -> Raster:
        """The raster of this step and shape around the middle of a box (4,) x0, y0, x1, y1."""
        center = (box[:2] + box[2:]) / 2
        origin = center - np.array([shape[1], shape[0]], np.float32) * (step / 2)
        return cls(origin.astype(np.float32), step, shape)

    @classmethod
    def over(cls, box: Floats, shape: tuple[int, int]) -> Raster:
        """The raster of this shape whose columns fill a box (4,)."""
        return cls(box[:2], float(box[2] - box[0]) / shape[1], shape)

    @property
    def box(self) -> Floats:
        """(4,) float32 x0, y0, x1, y1, see `origin`; it may reach over the picture's edge."""
        size = np.array([self.shape[1], self.shape[0]], np.float32) * self.step
        return np.concatenate([self.origin, self.origin + size]).astype(np.float32)

    def to_cells(self, points: Floats) -> Floats:
        """Cell coordinates of source positions (…, 2); centres of cells are at integers."""
        cells: Floats = _cell_at(self.origin, self.step, points).astype(np.float32)
        return cells

    def centers(self) -> tuple[Doubles, Doubles]:
        """Source x of every column's centre and y of every row's."""
        x = _cell_center(self.origin[0], self.step, np.arange(self.shape[1]))
        y = _cell_center(self.origin[1], self.step, np.arange(self.shape[0]))
        return x, y

    def inside(self, size: tuple[int, int]) -> Bools:
        """(rows, columns) whether each cell's centre lies in a picture of `size` (height, width)."""
        x, y = self.centers()
        within: Bools = _within(y, size[0])[:, None] & _within(x, size[1])
        return within

    def read(self, values: Floats, xs: Floats, ys: Floats) -> Floats:
        """Values (rows, columns) at source columns xs (w,) and rows ys (h,), bilinear: (h, w) float32.

        What lies beyond the raster is 0, a cell around it fades to that.
        """
        padded = np.zeros((values.shape[0] + 2, values.shape[1] + 2), values.dtype)
        padded[1:-1, 1:-1] = values
        rows = (np.asarray(ys, np.float64) - self.origin[1] + 0.5) / self.step + 0.5
        columns = (np.asarray(xs, np.float64) - self.origin[0] + 0.5) / self.step + 0.5
        out = np.empty((len(rows), len(columns)), np.float32)
        read_grid(padded, columns, rows, out)
        return out

    def crop(self, corner: Floats) -> Raster:
        """The same cells in the coordinates of a crop whose first pixel is `corner` (2,)."""
        return Raster((self.origin - corner).astype(np.float32), self.step, self.shape)


def _within(positions: Doubles, count: int) -> Bools:
    return np.asarray((positions >= -0.5) & (positions <= count - 0.5))


def scaled(points: Reals, ratio: Floats | float) -> Reals:
    """Positions (…, 2) of a picture in a copy of it whose sides are `ratio` (2,) times as long."""
    return np.asarray(_on_copy(points, ratio), points.dtype)


def sites(count: int, ratio: float) -> Floats:
    """Positions in a picture, (count,) float32, of the pixels along a side of a copy that is `ratio` times as long."""
    return np.asarray((np.arange(count, dtype=np.float32) + 0.5) / ratio - 0.5, np.float32)


def fixed_point(polygon: Floats) -> NDArray[np.int32]:
    """Corners (n, 2) for OpenCV's drawing with `shift=SUBPIXEL_BITS`: sixteenths of a pixel."""
    return np.rint(polygon * (1 << SUBPIXEL_BITS)).astype(np.int32)


def inside(polygon: Floats, shape: tuple[int, ...]) -> Bools:
    """(h, w) the cells inside a polygon (n, 2) whose corners are cells' columns and rows, rounded to whole ones."""
    drawn = np.zeros(shape, np.uint8)
    return cv2.fillPoly(drawn, [np.rint(polygon).astype(np.int32)], 1) > 0


def square(reach: float) -> Bytes:
    """A kernel of OpenCV's morphology that reaches so many cells to each side, one at least."""
    return block(2 * max(1, round(reach)) + 1)


def block(side: int) -> Bytes:
    """A kernel of OpenCV's morphology of so many cells a side: opening by it takes away what is narrower."""
    return np.ones((side, side), np.uint8)


def first_reading(corner: float, step: float) -> float:
    """Where the first of even readings lies that are `step` pixels apart and begin at a raster's `corner`."""
    return corner + 0.5 * step - 0.5


def scaled_affine(matrix: Doubles, ratio: Doubles | float) -> Doubles:
    """A (2, 3) map to positions of a picture as a map to those of its copy with sides `ratio` (2,) times as long."""
    sides = np.broadcast_to(np.asarray(ratio, np.float64), (2,))
    out = matrix * sides[:, None]
    out[:, 2] += 0.5 * sides - 0.5
    return out


def from_edge(positions: Reals) -> Reals:
    """Positions measured from a picture's own corner, as lengths and networks do, counted from its first centre."""
    return np.asarray(positions - 0.5, positions.dtype)


def to_edge(positions: Reals) -> Reals:
    """Positions counted from a picture's first centre, from its own corner, which pixel (0, 0) begins at."""
    return np.asarray(positions + 0.5, positions.dtype)


def centers_in_unit(count: int) -> Floats:
    """The centres of `count` equal parts of the unit interval, (count,) float32."""
    return np.asarray((np.arange(count, dtype=np.float32) + 0.5) / count, np.float32)
