"""Compiled kernels of the matte's edge at picture resolution; see `pvg.rendering.edges`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pvg._arrays import Bools, Bytes, Floats, Ints
from pvg._compiled import kernel
from pvg.raster import cell_at, cell_center, cell_middle
from pvg.rendering._kernels import Samples

SUMS = 5  # of one side: cells, their three colours, and the squared lengths of those
LINE = 5  # three slopes, an offset, the trust


class Planes(NamedTuple):
    """The planes of a picture, cut out; a sample of the second and third is 2^log2x × 2^log2y pixels."""

    first: Samples
    second: Samples
    third: Samples
    log2x: int
    log2y: int


class Cells(NamedTuple):
    """Where a raster's cells lie in the planes, pixels.  corner: (2,) x, y of the first one;  step: a cell's side."""

    corner: Floats
    step: float


class LineRule(NamedTuple):
    """How `color_lines` finds the share of skin in a colour.

    reach: blocks to either side that are averaged;  noise: squared levels;  few: cells of either side that are trusted
    in full;  rise: (2, 2) where between both colours the share rises from 0 to 1, beside what is darker than the skin
    and beside what is not;  as_bright: (2,) the surroundings' first plane over the skin's, from the one to the other.
    """

    reach: int
    noise: float
    few: float
    rise: Floats
    as_bright: Floats


@kernel(inline=True)
def _sample(plane: Samples, x: float, y: float) -> float:
    """The sample that lies `x`, `y` from the plane's corner, the nearest one beyond its sides."""
    column, row = min(max(int(x), 0), plane.shape[1] - 1), min(max(int(y), 0), plane.shape[0] - 1)
    return float(plane[row, column])


@kernel()
def gather(planes: Planes, weights: Floats, cells: Cells, kind: Bytes, wanted: Bools, sums: Floats) -> None:
    """Add up the colours of the cells around an edge, skin's and those of its surroundings apart.

    weights: (3,) of the planes' codes;  kind: (h, w) of the cells, 1 on skin, 2 off it, 0 on neither;
    wanted: (rows, columns) blocks of 2×2 cells that count;  sums: (rows, columns, 2 · SUMS) over them, zero before.
    """
    first, second, third, corner, step = planes.first, planes.second, planes.third, cells.corner, cells.step
    across, along = 1.0 / (1 << planes.log2x), 1.0 / (1 << planes.log2y)
    height, width = first.shape
    for i in range(kind.shape[0]):
        middle = cell_middle(corner[1], step, i)
        top, bottom = middle - 0.25 * step, middle + 0.25 * step
        if middle < 0.0 or middle > height:
            continue
        for j in range(kind.shape[1]):
            if kind[i, j] == 0 or not wanted[i >> 1, j >> 1]:
                continue
            center = cell_middle(corner[0], step, j)
            left, right = center - 0.25 * step, center + 0.25 * step
            if center < 0.0 or center > width:
                continue
            a = _sample(first, left, top) + _sample(first, right, top)
            a = 0.25 * weights[0] * (a + _sample(first, left, bottom) + _sample(first, right, bottom))
            b = weights[1] * _sample(second, center * across, middle * along)
            c = weights[2] * _sample(third, center * across, middle * along)
            to, k = sums[i >> 1, j >> 1], SUMS * (int(kind[i, j]) - 1)
            to[k] += np.float32(1.0)
            to[k + 1] += np.float32(a)
            to[k + 2] += np.float32(b)
            to[k + 3] += np.float32(c)
            to[k + 4] += np.float32(a * a + b * b + c * c)


@kernel(fastmath=True)
def color_lines(sums: Floats, weights: Floats, near: Bytes, rule: LineRule, lines: Floats) -> None:
    """lines (rows, columns, LINE): the share of skin in a colour, by the line from its surroundings' colour to skin's.

    share · trust = slopes · codes + offset. sums, weights: see `gather`;  near: blocks that are wanted, the others
    become 0.
    """
    reach, rise, as_bright = rule.reach, rule.rise, rule.as_bright
    rows, columns = near.shape
    total = np.empty(2 * SUMS, np.float32)
    for i in range(rows):
        for j in range(columns):
            lines[i, j, :] = np.float32(0.0)
            if not near[i, j]:
                continue
            total[:] = np.float32(0.0)
            for y in range(max(0, i - reach), min(rows, i + reach + 1)):
                for x in range(max(0, j - reach), min(columns, j + reach + 1)):
                    for k in range(2 * SUMS):
                        total[k] += sums[y, x, k]
            inner, outer = total[0], total[SUMS]
            if inner < 1.0 or outer < 1.0:
                continue
            length, inner_square, outer_square, offset = 0.0, 0.0, 0.0, 0.0
            for k in range(1, 4):
                skin, around = total[k] / inner, total[SUMS + k] / outer
                inner_square += skin * skin
                outer_square += around * around
                offset += around * (skin - around)
                length += (skin - around) ** 2
            spread = max(total[4] / inner - inner_square, 0.0) + max(total[SUMS + 4] / outer - outer_square, 0.0)
            trust = length / (length + spread + rule.noise) * min(1.0, inner / rule.few) * min(1.0, outer / rule.few)
            ratio = total[SUMS + 1] / outer / max(total[1] / inner, 1e-3)
            bright = min(max((ratio - as_bright[0]) / (as_bright[1] - as_bright[0]), 0.0), 1.0)
            begin = rise[0, 0] + bright * (rise[1, 0] - rise[0, 0])
            gain = 1.0 / (rise[0, 1] + bright * (rise[1, 1] - rise[0, 1]) - begin)
            scale = trust * gain / max(length, 1e-3)
            for k in range(1, 4):
                slope = (total[k] / inner - total[SUMS + k] / outer) * scale * weights[k - 1]
                lines[i, j, k - 1] = np.float32(slope)
            lines[i, j, 3] = np.float32(-offset * scale - trust * gain * begin)
            lines[i, j, 4] = np.float32(trust)


@kernel(inline=True)
def _read_block(lines: Floats, i: int, j: int, k: int) -> np.float32:
    """The value of the blocks at the middle of cell (i, j), bilinear."""
    rows, columns = lines.shape[0], lines.shape[1]
    y, x = i >> 1, j >> 1
    v = min(y + 1, rows - 1) if i & 1 else max(y - 1, 0)
    u = min(x + 1, columns - 1) if j & 1 else max(x - 1, 0)
    near, far = np.float32(0.75), np.float32(0.25)
    value: np.float32 = near * (near * lines[y, x, k] + far * lines[y, u, k])
    value += far * (near * lines[v, x, k] + far * lines[v, u, k])
    return value


@kernel()
def spread_to_cells(lines: Floats, touched: Bytes, cells: Floats) -> None:
    """cells (h, w, LINE): lines (rows, columns, LINE) of blocks of 2×2 cells at the middles of the `touched` cells."""
    for i in range(touched.shape[0]):
        for j in range(touched.shape[1]):
            if touched[i, j]:
                for k in range(LINE):
                    cells[i, j, k] = _read_block(lines, i, j, k)


@kernel(fastmath=True)
def _chroma_at(plane: Samples, y: int, log2y: int, first: int, last: int, log2x: int, row: Floats, wide: Floats) -> int:
    """A chroma plane's samples at luma's columns [first, last) of its row `y`, each between two rows and columns.

    They are in `wide` from the place that is returned on.  row: as wide as the plane, scratch.
    """
    near = y >> log2y
    far = near
    if log2y:
        far = min(near + 1, plane.shape[0] - 1) if y & 1 else max(near - 1, 0)
    begin = first >> log2x
    end = min(((last - 1) >> log2x) + 1 + log2x, plane.shape[1])
    above, below, count = plane[near, begin:end], plane[far, begin:end], end - begin
    most, least, half = np.float32(0.75), np.float32(0.25), np.float32(0.5)
    to = row if log2x else wide
    for k in range(count):
        to[k] = most * np.float32(above[k]) + least * np.float32(below[k])
    if log2x == 0:
        return 0
    for k in range(count - 1):
        wide[2 * k] = row[k]
        wide[2 * k + 1] = half * (row[k] + row[k + 1])
    wide[2 * count - 2] = row[count - 1]
    wide[2 * count - 1] = row[count - 1]
    return first & 1


@kernel(fastmath=True)
def _stretch(
    cells: Floats,
    unknown: Bytes,
    undecided: Bools,
    starts: Ints,
    begin: Floats,
    pace: np.float32,
    out: Floats,
) -> None:
    """out (LINE + 1, w): a row of cells (columns, LINE) and of `unknown` (columns,) along it at each pixel.

    undecided: (columns − 1,) between which cells it is wanted;  starts: (columns,) the first pixel from each cell's
    middle on;  begin: (columns − 1,) how far that pixel is beyond the middle, cells;  pace: cells a pixel.
    """
    w = out.shape[1]
    for j in range(len(undecided)):
        if not undecided[j]:
            continue
        x0, x1 = max(starts[j], 0), min(starts[j + 1], w)
        for k in range(LINE + 1):
            left = np.float32(unknown[j]) if k == LINE else cells[j, k]
            right = np.float32(unknown[j + 1]) if k == LINE else cells[j + 1, k]
            for x in range(x0, x1):
                out[k, x] = left + (begin[j] + pace * np.float32(x - x0)) * (right - left)


@kernel(fastmath=True)
def follow_lines(
    planes: Planes,
    window: tuple[int, int],
    cells: Cells,
    unknown: Bytes,
    lines: Floats,
    opacity: np.float32,
    alpha: Floats,
) -> None:
    """Let alpha (h, w) follow the picture where `unknown` (rows, columns) is 1, in place; bilinear to 0.

    window: x, y of alpha's first pixel;  lines: (rows, columns, LINE) of the cells, whose touched ones are defined;
    opacity: alpha's value on skin.
    """
    first, second, third, log2x, log2y = planes
    corner, step = cells
    h, w = alpha.shape
    rows, columns = unknown.shape
    one, none, full, pace = np.float32(1.0), np.float32(0.0), np.float32(1.0) / opacity, np.float32(1.0 / step)
    starts, begin = np.empty(columns, np.int64), np.empty(columns, np.float32)
    for j in range(columns):
        starts[j] = int(np.ceil(cell_center(corner[0], step, j) - window[0]))
        begin[j] = np.float32(cell_at(corner[0], step, window[0] + max(starts[j], 0)) - j)
    undecided = np.zeros(columns - 1, np.bool_)
    upper, lower = np.empty((LINE + 1, w), np.float32), np.empty((LINE + 1, w), np.float32)
    # chroma read sample by sample would give the edge steps of two pixels where it lies between two hues
    row, at = np.empty(second.shape[1], np.float32), -1
    one_wide, other_wide = np.empty(first.shape[1] + 2, np.float32), np.empty(first.shape[1] + 2, np.float32)
    for y in range(h):
        place = cell_at(corner[1], step, window[1] + y)
        i = int(np.floor(place))
        if i < 0 or i > rows - 2:
            continue
        if i != at:
            at = i
            for j in range(columns - 1):
                undecided[j] = (unknown[i, j] | unknown[i, j + 1] | unknown[i + 1, j] | unknown[i + 1, j + 1]) != 0
            _stretch(lines[i], unknown[i], undecided, starts, begin, pace, upper)
            _stretch(lines[i + 1], unknown[i + 1], undecided, starts, begin, pace, lower)
        if not undecided.any():
            continue
        f, out, luma = np.float32(place - i), alpha[y], first[window[1] + y]
        j = 0
        while j < columns - 1:
            if not undecided[j]:
                j += 1
                continue
            x0 = max(starts[j], 0)
            while j < columns - 1 and undecided[j]:
                j += 1
            x1 = min(starts[j], w)
            if x0 >= x1:
                continue
            top, begin_x, end_x = window[1] + y, window[0] + x0, window[0] + x1
            k = _chroma_at(second, top, log2y, begin_x, end_x, log2x, row, one_wide)
            _chroma_at(third, top, log2y, begin_x, end_x, log2x, row, other_wide)
            own, b, c = luma[begin_x:end_x], one_wide[k : k + x1 - x0], other_wide[k : k + x1 - x0]
            u, v, to = upper[:, x0:x1], lower[:, x0:x1], out[x0:x1]
            # here and not in a function of its own: merged in it costs 4 % of this kernel, called 60 %
            for x in range(x1 - x0):
                known = to[x] * full
                share = (u[0, x] + f * (v[0, x] - u[0, x])) * np.float32(own[x]) + u[3, x] + f * (v[3, x] - u[3, x])
                share += (u[1, x] + f * (v[1, x] - u[1, x])) * b[x]
                share += (u[2, x] + f * (v[2, x] - u[2, x])) * c[x]
                share += (one - u[4, x] - f * (v[4, x] - u[4, x])) * known
                share = min(max(share, none), one)
                to[x] = opacity * (known + (u[5, x] + f * (v[5, x] - u[5, x])) * (share - known))
