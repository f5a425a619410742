# Compiled functions take their types from the first call.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, no-untyped-call"
"""Compiled kernels on picture planes: bilinear reading of coarse grids, and the correction applied to samples.

A grid is first stretched along its own rows, of which there are few, so that what is done for every sample runs along
contiguous memory and vectorises.
"""

from __future__ import annotations

import numpy as np
from numba import njit, vectorize


@njit(cache=True, nogil=True, fastmath=True)
def _cells(places, count, index, share):
    """Split positions into the node before and the way to the next; those outside a grid of `count` are clamped."""
    for j in range(len(places)):
        place = min(max(places[j], 0.0), count - 1.0)
        index[j] = min(int(place), count - 2)
        share[j] = place - index[j]


@njit(cache=True, nogil=True, fastmath=True)
def _stretch(row, index, share, out):
    """out[j] = the row of a grid between its nodes index[j] and index[j] + 1."""
    for j in range(len(out)):
        k = index[j]
        out[j] = row[k] + share[j] * (row[k + 1] - row[k])


@njit(cache=True, nogil=True, fastmath=True)
def _reach(plane, upper, at, index, share, wide):
    """Have the stretched rows `upper` and `upper` + 1 in `wide` (2, n), where row `at` and the next were; in order."""
    if upper == at:
        return upper
    if upper == at + 1:
        wide[0] = wide[1]
    else:
        _stretch(plane[upper], index, share, wide[0])
    _stretch(plane[upper + 1], index, share, wide[1])
    return upper


@njit(cache=True, nogil=True, fastmath=True)
def read_grid(plane, columns, rows, out):
    """out[i, j] = the bilinear value of plane at (columns[j], rows[i]), in nodes; positions outside are clamped."""
    h, w = plane.shape
    index, share = np.empty(len(columns), np.int32), np.empty(len(columns), np.float32)
    _cells(columns, w, index, share)
    wide, at = np.empty((2, len(columns)), np.float32), -2
    for i in range(len(rows)):
        place = min(max(rows[i], 0.0), h - 1.0)
        upper = min(int(place), h - 2)
        at = _reach(plane, upper, at, index, share, wide)
        f = np.float32(place - upper)
        a, b, to = wide[0], wide[1], out[i]
        for j in range(len(to)):
            to[j] = a[j] + f * (b[j] - a[j])


@njit(cache=True, nogil=True, fastmath=True)
def block_means(alpha, log2x, log2y, out):
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


@njit(cache=True, nogil=True, fastmath=True)
def _run(weight):
    """The run [first, last) outside which a row of weights is zero."""
    first, last = 0, len(weight)
    while first < last and weight[first] == np.float32(0.0):
        first += 1
    while first < last and weight[last - 1] == np.float32(0.0):
        last -= 1
    return first, last


@vectorize(["float32(float32, float32, float32, float32, float32)"], cache=True)
def roll_off(value, toe, below, knee, above):
    """The value between toe and knee, approaching black below and white above; slope at most 1 and continuous.

    below, above: how far black lies below the toe and white above the knee.
    """
    over, under = max(value - knee, np.float32(0.0)), max(toe - value, np.float32(0.0))
    beyond = over + under  # one of them is zero, so one division does for both
    room = above if over > np.float32(0.0) else below
    taken = beyond * beyond / (room + beyond)  # x − x / (1 + x / r) = x² / (r + x)
    return value - taken if over > np.float32(0.0) else value + taken


@njit(cache=True, nogil=True, fastmath=True)
def apply_change(part, before, broad, alpha, columns, rows, shift, gain, factor, level, bend, top):
    """part += alpha (R(before + shift + (gain − 1 + factor) (before − level)) − R(before)), in place.

    Rounded and held to [0, top].  R is the roll-off of `roll_off`.  Where the bracket before it is positive, (broad −
    level) stands for (before − level): what broad lacks of before is then left as it is.
    part, before, broad: (r, c) uint8 or uint16 samples, before as the frame came, broad the same or smoothed.
    alpha: (r, c) float32, the matte over their blocks of pixels.
    columns, rows: float64 positions of the samples in the grids `shift` and `gain`; a `gain` without rows stands for 1
    everywhere.  bend: (4,) float32, see `roll_off`, or empty for none.
    """
    count, (h, w) = part.shape[1], shift.shape
    index, share = np.empty(count, np.int32), np.empty(count, np.float32)
    _cells(columns, w, index, share)
    change = np.empty(count, np.float32)
    low, steep = np.empty((2, count), np.float32), np.ones((2, count), np.float32)
    at_low, at_steep = -2, -2
    excess, half, none = factor - np.float32(1.0), np.float32(0.5), np.float32(0.0)
    for i in range(part.shape[0]):
        first, last = _run(alpha[i])
        if first >= last:
            continue
        place = min(max(rows[i], 0.0), h - 1.0)
        upper = min(int(place), h - 2)
        f = np.float32(place - upper)
        at_low = _reach(shift, upper, at_low, index, share, low)
        if len(gain):
            at_steep = _reach(gain, upper, at_steep, index, share, steep)
        a, b, c, d = low[0, first:last], low[1, first:last], steep[0, first:last], steep[1, first:last]
        v, was, wide, to = alpha[i, first:last], before[i, first:last], broad[i, first:last], part[i, first:last]
        for j in range(last - first):
            slope = c[j] + f * (d[j] - c[j]) + excess
            taken = np.float32(wide[j]) if slope > none else np.float32(was[j])
            change[j] = a[j] + f * (b[j] - a[j]) + slope * (taken - level)
        if len(bend):
            toe, below, knee, above = bend[0], bend[1], bend[2], bend[3]
            for j in range(last - first):
                source = np.float32(was[j])
                wanted = source + change[j]
                change[j] = roll_off(wanted, toe, below, knee, above) - roll_off(source, toe, below, knee, above)
        for j in range(last - first):
            to[j] = np.int32(min(max(np.float32(to[j]) + v[j] * change[j] + half, none), top))


@njit(cache=True, nogil=True, fastmath=True)
def mean_above(before, alpha, columns, rows, low):
    """The mean of before − low over the matte; low is a grid, see `apply_change`. 0 where the matte is empty."""
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
