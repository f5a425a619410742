"""Compiled kernels that apply a correction to the samples of a picture's planes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg._bilinear import reach, read_grid, split
from pvg._compiled import kernel, ufunc

Samples = NDArray[np.uint8] | NDArray[np.uint16]


@kernel(fastmath=True)
def block_means(alpha: Floats, log2x: int, log2y: int, out: Floats) -> None:
    """out (r, c) = alpha (h, w) averaged over blocks of 2^log2x × 2^log2y, each at most 2, or what there is of one."""
    h, w = alpha.shape
    for i in range(out.shape[0]):
        top, bottom, to = i << log2y, min((i + 1) << log2y, h), out[i]
        to[:] = np.float32(0.0)
        for y in range(top, bottom):
            row = alpha[y]
            if log2x == 0:
                for j in range(w):
                    to[j] += row[j]
            else:
                for j in range(w >> 1):
                    to[j] += row[2 * j] + row[2 * j + 1]
                if w & 1:
                    to[w >> 1] += np.float32(2.0) * row[w - 1]
        scale = np.float32(1.0 / ((bottom - top) << log2x))
        for j in range(len(to)):
            to[j] *= scale


@kernel(fastmath=True)
def _run(weight: Floats) -> tuple[int, int]:
    """The run [first, last) outside which a row of weights is zero."""
    first, last = 0, len(weight)
    while first < last and weight[first] == np.float32(0.0):
        first += 1
    while first < last and weight[last - 1] == np.float32(0.0):
        last -= 1
    return first, last


@ufunc("float32(float32, float32, float32, float32, float32)")
def roll_off(value: Any, toe: Any, below: Any, knee: Any, above: Any) -> Any:
    """The value between toe and knee, approaching black below and white above; slope at most 1 and continuous.

    below, above: how far black lies below the toe and white above the knee.
    """
    over, under = max(value - knee, np.float32(0.0)), max(toe - value, np.float32(0.0))
    beyond = over + under  # one of them is zero, so one division does for both
    room = above if over > np.float32(0.0) else below
    taken = beyond * beyond / (room + beyond)  # x − x / (1 + x / r) = x² / (r + x)
    return value - taken if over > np.float32(0.0) else value + taken


@kernel(fastmath=True)
def apply_correction(
    part: Samples,
    before: Samples,
    broad: Samples,
    alpha: Floats,
    columns: Doubles,
    rows: Doubles,
    shift: Floats,
    contrast_field: Floats,
    contrast_less_one: np.float32,
    level: np.float32,
    bend: Floats,
    top: np.float32,
) -> None:
    """part += α (R(before + (λ − 1)(before − level) + shift) − R(before)), in place: u' = λI + H(g' − λg), eq. (1).

    Rounded and held to [0, top].  R is the roll-off of `roll_off`.  Where λ − 1 is positive, (broad − level) stands for
    (before − level): what broad lacks of before is then left as it is.
    part, before, broad: (r, c) uint8 or uint16 samples, before as the frame came, broad the same or smoothed.
    alpha: (r, c) float32, the matte over their blocks of pixels.
    columns, rows: positions of the samples in the grids `shift`, H(g' − λg), and `contrast_field`, λ. One of two says
    λ: a field without rows stands for 1 everywhere, and `contrast_less_one`, λ − 1 as a number, is 0 beside a field.
    bend: (4,) float32, see `roll_off`, or empty for none.
    """
    count, (h, w) = part.shape[1], shift.shape
    index, share = np.empty(count, np.int32), np.empty(count, np.float32)
    split(columns, w, index, share)
    change = np.empty(count, np.float32)
    added, contrast = np.empty((2, count), np.float32), np.ones((2, count), np.float32)
    at_added, at_contrast = -2, -2
    offset, half, none = contrast_less_one - np.float32(1.0), np.float32(0.5), np.float32(0.0)
    for i in range(part.shape[0]):
        first, last = _run(alpha[i])
        if first >= last:
            continue
        place = min(max(rows[i], 0.0), h - 1.0)
        upper = min(int(place), h - 2)
        f = np.float32(place - upper)
        at_added = reach(shift, upper, at_added, index, share, added)
        if len(contrast_field):
            at_contrast = reach(contrast_field, upper, at_contrast, index, share, contrast)
        a, b = added[0, first:last], added[1, first:last]
        c, d = contrast[0, first:last], contrast[1, first:last]
        v, was, wide, to = alpha[i, first:last], before[i, first:last], broad[i, first:last], part[i, first:last]
        for j in range(last - first):
            excess = c[j] + f * (d[j] - c[j]) + offset  # λ − 1
            taken = np.float32(wide[j]) if excess > none else np.float32(was[j])
            change[j] = a[j] + f * (b[j] - a[j]) + excess * (taken - level)
        if len(bend):
            toe, below, knee, above = bend[0], bend[1], bend[2], bend[3]
            for j in range(last - first):
                source = np.float32(was[j])
                wanted = source + change[j]
                change[j] = roll_off(wanted, toe, below, knee, above) - roll_off(source, toe, below, knee, above)
        for j in range(last - first):
            to[j] = np.int32(min(max(np.float32(to[j]) + v[j] * change[j] + half, none), top))


@kernel(fastmath=True)
def mean_above(before: Samples, alpha: Floats, columns: Doubles, rows: Doubles, low: Floats) -> float:
    """The mean of before − low over the matte; low is a grid, see `apply_correction`. 0 where the matte is empty."""
    field = np.empty(before.shape, np.float32)
    read_grid(low, columns, rows, field)
    total, mass = np.float64(0.0), np.float64(0.0)
    for i in range(before.shape[0]):
        weight = alpha[i]
        first, last = _run(weight)
        of_row, mass_of_row = np.float32(0.0), np.float32(0.0)
        for j in range(first, last):
            of_row += weight[j] * (np.float32(before[i, j]) - field[i, j])
            mass_of_row += weight[j]
        total += of_row
        mass += mass_of_row
    return total / mass if mass > 0.0 else 0.0
