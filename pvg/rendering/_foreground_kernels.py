"""Compiled kernels of what the pixels at a matte's edge show of skin; see `pvg.rendering.foreground`."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg._bilinear import reach, split
from pvg._compiled import kernel
from pvg.rendering._kernels import Grid, Samples, whole_run


@kernel(fastmath=True)
def least_around(alpha: Floats, hardly: np.float32, beta: Floats) -> None:
    """beta (h, w) = the least of alpha (h, w) at each pixel and its eight neighbours, `hardly` at least where there is
    as much at the pixel itself.
    """
    h, w = alpha.shape
    least = np.empty(w + 2, np.float32)  # of three rows, one column more at each end
    for i in range(h):
        first, last = whole_run(alpha[i])
        beta[i, :first] = np.float32(0.0)
        beta[i, last:] = np.float32(0.0)
        if first >= last:
            continue
        begin, end = max(first - 1, 0), min(last + 1, w)
        own, above, below = alpha[i, begin:end], alpha[max(i - 1, 0), begin:end], alpha[min(i + 1, h - 1), begin:end]
        column = least[1 : 1 + end - begin]
        for j in range(end - begin):
            column[j] = min(above[j], own[j], below[j])
        least[0], least[1 + end - begin] = least[1], least[end - begin]
        at = first - begin
        left, middle, right = least[at:], least[at + 1 :], least[at + 2 :]
        here, to = alpha[i, first:last], beta[i, first:last]
        for j in range(last - first):
            to[j] = max(min(left[j], middle[j], right[j]), min(here[j], hardly))


@kernel(fastmath=True)
def sum_sure(part: Samples, beta: Floats, sure: np.float32, cell: int, sums: Floats) -> None:
    """sums (2, rows, columns) = the sum over each cell of cell × cell samples with β ≥ sure, and their number.

    part: (r, c) samples;  beta: (r, c), see `show_skin`.
    """
    rows, columns = part.shape
    total, number = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for k in range(-(-rows // cell)):
        total[:] = np.float32(0.0)
        number[:] = np.float32(0.0)
        for i in range(k * cell, min(rows, (k + 1) * cell)):
            for j in range(columns):  # without a branch, so that it vectorises
                counts = np.float32(beta[i, j] >= sure)
                total[j] += counts * np.float32(part[i, j])
                number[j] += counts
        for c in range(-(-columns // cell)):
            for j in range(c * cell, min(columns, (c + 1) * cell)):
                sums[0, k, c] += total[j]
                sums[1, k, c] += number[j]


@kernel()
def known_means(sums: Floats, mass: Floats, least: np.float32, unknown: np.float32) -> None:
    """sums (rows, columns) /= mass, in place; `unknown` where that is not more than `least`."""
    for i in range(sums.shape[0]):
        for j in range(sums.shape[1]):
            mean = sums[i, j] / max(mass[i, j], np.float32(1e-6))
            sums[i, j] = mean if mass[i, j] > least else unknown


@kernel(fastmath=True)
def show_skin(part: Samples, beta: Floats, mean: Grid, sure: np.float32) -> None:
    """part = β² part + (1 − β²) mean where 0 < β < sure, in place, rounded; where the mean is not negative.

    part: (r, c) samples;  beta: (r, c) float32 β in [0, 1], see `pvg.rendering.foreground`;
    mean: code values, negative where it is not known.
    """
    values, count = mean.values, part.shape[1]
    h, w = values.shape
    (index, share), (upper, down) = split(mean.columns, w), split(mean.rows, h)
    held = np.empty((2, count), np.float32)
    at, half, none, one = -2, np.float32(0.5), np.float32(0.0), np.float32(1.0)
    for i in range(part.shape[0]):
        first, last = whole_run(beta[i])
        if first >= last:
            continue
        f = down[i]
        at = at if upper[i] == at else reach(values, upper[i], at, index, share, held)
        a, b, v, to = held[0, first:last], held[1, first:last], beta[i, first:last], part[i, first:last]
        for j in range(last - first):
            skin = a[j] + f * (b[j] - a[j])
            mixed = np.float32((v[j] > none) & (v[j] < sure) & (skin >= none))
            own = one - mixed * (one - v[j] * v[j])
            to[j] = np.int32(own * np.float32(to[j]) + (one - own) * skin + half)
