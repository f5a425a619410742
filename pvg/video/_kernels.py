"""Compiled kernels that average a plane over square cells and turn plane codes into RGB."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bytes, Floats
from pvg._compiled import kernel

Plane = NDArray[np.uint8] | NDArray[np.uint16]
Counts = NDArray[np.int32]


class Taps(NamedTuple):
    """The samples of a row that make each of m cells, see `taps`.

    starts, counts: (m,) the first of them and how many;  weights: (m, n) float32.
    """

    starts: Counts
    counts: Counts
    weights: Floats


class DisplayTables(NamedTuple):
    """From a clip's own R'G'B' to what an SDR display shows, in TABLE steps.

    light: (3, TABLE) by signal;  raised: (TABLE,) what a luminance is multiplied by for the system gamma, by its root;
    weights: (3,) of that luminance;  gamut: (3, 3);  shown: (TABLE,) SDR levels by the root of light.
    """

    light: Floats
    raised: Floats
    weights: Floats
    gamut: Floats
    shown: Floats


@kernel()
def taps(first: float, step: float, k: int, count: int, start: Counts, cells: Counts) -> Floats:
    """Weights of the samples of a row of `count` that make each cell: (len(cells), n) float32, from start[i] on.

    A cell is the mean of k bilinear readings; the readings of all cells are evenly spaced by step / k from `first` on.
    cells: (m,) int32 and start: (m,) int32 are the output: how many samples a cell needs, and the first of them.
    """
    fine = step / k
    width = int(np.ceil((k - 1) * fine)) + 3
    weights = np.zeros((len(cells), width), np.float32)
    for i in range(len(cells)):
        low = first + i * step
        origin = min(max(int(np.floor(low)), 0), count - 1)
        start[i] = origin
        longest = 1
        for s in range(k):
            place = min(max(low + s * fine, 0.0), count - 1.0)
            at = min(int(place), count - 1)
            share = place - at
            weights[i, at - origin] += np.float32((1.0 - share) / k)
            longest = max(longest, at - origin + 1)
            if share > 0.0 and at + 1 < count:
                weights[i, at + 1 - origin] += np.float32(share / k)
                longest = max(longest, at + 2 - origin)
        cells[i] = longest
    return weights


@kernel(fastmath=True)
def average_cells(plane: Plane, x_taps: Taps, y_taps: Taps, out: Floats) -> None:
    """out (h, w) float32 = plane averaged over cells, by the weights of `taps` along rows and columns."""
    start_x, count_x, weights_x = x_taps
    start_y, count_y, weights_y = y_taps
    left, right = plane.shape[1], 0
    for j in range(len(start_x)):
        left = min(left, start_x[j])
        right = max(right, start_x[j] + count_x[j])
    row = np.empty(plane.shape[1], np.float32)
    for i in range(len(start_y)):
        for x in range(left, right):
            row[x] = np.float32(0.0)
        for k in range(count_y[i]):
            weight, source = weights_y[i, k], plane[start_y[i] + k]
            if weight == np.float32(0.0):  # between the readings of a large cell
                continue
            for x in range(left, right):
                row[x] += weight * np.float32(source[x])
        for j in range(len(start_x)):
            total, begin = np.float32(0.0), start_x[j]
            for k in range(count_x[j]):
                total += weights_x[j, k] * row[begin + k]
            out[i, j] = total


@kernel(fastmath=True)
def codes_to_rgb(first: Plane, second: Plane, third: Plane, matrix: Floats, offset: Floats, out: Bytes) -> None:
    """out (h, w, 3) uint8 = matrix (3, 3) · (codes of three planes (h, w)) + offset (3,), rounded and clipped."""
    h, w = first.shape
    half, top, none = np.float32(0.5), np.float32(255.0), np.float32(0.0)
    line = np.empty(w, np.uint8)  # written a channel at a time: interleaved stores do not vectorise
    for i in range(h):
        a, b, c = first[i], second[i], third[i]
        for k in range(3):
            by_a, by_b, by_c, start = matrix[k, 0], matrix[k, 1], matrix[k, 2], offset[k]
            for j in range(w):
                value = by_a * np.float32(a[j]) + by_b * np.float32(b[j]) + by_c * np.float32(c[j]) + start
                line[j] = np.uint8(np.int32(min(max(value, none), top) + half))
            for j in range(w):
                out[i, j, k] = line[j]


@kernel(fastmath=True)
def codes_to_sdr(
    first: Plane,
    second: Plane,
    third: Plane,
    matrix: Floats,
    offset: Floats,
    tables: DisplayTables,
    out: Bytes,
) -> None:
    """out (h, w, 3) uint8 = SDR-referred BT.709 of the codes of three planes (h, w).

    matrix (3, 3), offset (3,): from codes to the clip's own R'G'B', 0-255.
    """
    light, raised, weights, gamut, shown = tables
    h, w = first.shape
    last, none, one, half = np.float32(len(shown) - 1), np.float32(0.0), np.float32(1.0), np.float32(0.5)
    scale = last / np.float32(255.0)
    for i in range(h):
        for j in range(w):
            a, b, c = np.float32(first[i, j]), np.float32(second[i, j]), np.float32(third[i, j])
            at = (matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2] * c + offset[0]) * scale
            r = light[0, int(min(max(at, none), last) + half)]
            at = (matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2] * c + offset[1]) * scale
            g = light[1, int(min(max(at, none), last) + half)]
            at = (matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2] * c + offset[2]) * scale
            u = light[2, int(min(max(at, none), last) + half)]
            luminance = min(max(weights[0] * r + weights[1] * g + weights[2] * u, none), one)
            gain = raised[int(np.sqrt(luminance) * last + half)]
            for k in range(3):
                value = (gamut[k, 0] * r + gamut[k, 1] * g + gamut[k, 2] * u) * gain
                root = np.sqrt(min(max(value, none), one))
                out[i, j, k] = np.uint8(shown[int(root * last + half)] + half)
