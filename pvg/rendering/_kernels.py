"""Compiled kernels that apply a correction to the samples of a picture's planes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg._bilinear import reach, read_grid, split
from pvg._compiled import kernel

Samples = NDArray[np.uint8] | NDArray[np.uint16]
_STRIDE = 32
FAINT = np.float32(0.01)  # of all codes: chroma that is less has no hue to lose


class Grid(NamedTuple):
    """A coarse field, read bilinearly where the samples of a plane (r, c) lie.

    values: (h, w) at the grid's nodes;  columns: (c,) and rows: (r,), positions of the samples, counted in nodes.
    """

    values: Floats
    columns: Doubles
    rows: Doubles


class Codes(NamedTuple):
    """The scale of a plane's codes.  zero: black's, or grey's in chroma;  top: the largest one."""

    zero: np.float32
    top: np.float32


class Shown(NamedTuple):
    """What the samples of a plane (r, c) show of skin.

    before: as the frame came, at an edge the skin in them;  broad: the same, or smoothed;  luma: smoothed luma there.
    """

    before: Samples
    broad: Samples
    luma: Samples


class ToneMap(NamedTuple):
    """The map of colour F of one plane, by codes: F(before) = before + rise[luma] + fall[before] + excess · broad.

    tables: (2, top + 1), rise and fall, or (1, top + 1), rise alone;  bend: (4,) of `roll_off`, or empty for none.
    """

    tables: Floats
    excess: np.float32
    bend: Floats


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


@kernel(inline=True)
def _any(bits: NDArray[np.int32], first: int) -> bool:
    """Whether any of _STRIDE weights from `first` on is not zero, by their bits, whose loop vectorises."""
    found, block = np.int32(0), bits[first : first + _STRIDE]
    for j in range(_STRIDE):  # counted from 0: what may be negative does not vectorise
        found |= block[j]
    return bool(found != 0)


@kernel(inline=True)
def _all(bits: NDArray[np.int32], first: int) -> bool:
    """Whether all of _STRIDE weights from `first` on are more than zero, likewise."""
    block = bits[first : first + _STRIDE]
    least = block[0]
    for j in range(_STRIDE):
        least = min(least, block[j])
    return bool(least > 0)


@kernel()
def whole_run(weight: Floats) -> tuple[int, int]:
    """The run [first, last) outside which a row of weights is zero."""
    first, last, bits = 0, len(weight), weight.view(np.int32)
    while first + _STRIDE <= last and not _any(bits, first):
        first += _STRIDE
    while first < last and bits[first] == 0:
        first += 1
    while first + _STRIDE <= last and not _any(bits, last - _STRIDE):
        last -= _STRIDE
    while first < last and bits[last - 1] == 0:
        last -= 1
    return first, last


@kernel()
def next_run(weight: Floats, start: int) -> tuple[int, int]:
    """The next run [first, last) of weights that are not zero in a row, from `start` on; empty at the row's end."""
    first, end, bits = start, len(weight), weight.view(np.int32)
    while first + _STRIDE <= end and not _any(bits, first):
        first += _STRIDE
    while first < end and bits[first] == 0:
        first += 1
    last = first
    while last + _STRIDE <= end and _all(bits, last):
        last += _STRIDE
    while last < end and bits[last] != 0:
        last += 1
    return first, last


@kernel()
def rolled_off(
    value: np.float32, toe: np.float32, below: np.float32, knee: np.float32, above: np.float32
) -> np.float32:
    """The value between toe and knee, approaching black below and white above; slope at most 1 and continuous.

    below, above: how far black lies below the toe and white above the knee.
    """
    over, under = max(value - knee, np.float32(0.0)), max(toe - value, np.float32(0.0))
    beyond = over + under  # one of them is zero, so one division does for both
    room = above if over > np.float32(0.0) else below
    taken = beyond * beyond / (room + beyond)  # x − x / (1 + x / r) = x² / (r + x)
    return value - taken if over > np.float32(0.0) else value + taken


@kernel()
def roll_off(values: Floats, bend: Floats) -> Floats:
    """`rolled_off` of every value of a plane (h, w);  bend: its four numbers."""
    out = np.empty_like(values)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[i, j] = rolled_off(values[i, j], bend[0], bend[1], bend[2], bend[3])
    return out


@kernel(fastmath=True)
def apply_contrast(
    part: Samples, before: Samples, alpha: Floats, shift: Grid, excess: np.float32, codes: Codes
) -> None:
    """part += α (excess (before − zero) + shift), in place: u' = λI + H(g' − λg), eq. (1), with excess = λ − 1.

    Rounded and held to [0, top].
    part, before: (r, c) uint8 or uint16 samples, before as the frame came;  alpha: (r, c) float32, the matte over their
    blocks of pixels;  shift: H(g' − λg);  codes: with the level that λ leaves where it is for zero.
    """
    values, level, top = shift.values, codes.zero, codes.top
    count, (h, w) = part.shape[1], values.shape
    (index, share), (upper, down) = split(shift.columns, w), split(shift.rows, h)
    change, detail = np.empty(count, np.float32), np.empty(count, np.float32)
    added = np.empty((2, count), np.float32)
    at, half, none = -2, np.float32(0.5), np.float32(0.0)
    for i in range(part.shape[0]):
        first, last = whole_run(alpha[i])
        if first >= last:
            continue
        f = down[i]
        at = at if upper[i] == at else reach(values, upper[i], at, index, share, added)
        a, b = added[0, first:last], added[1, first:last]
        v, was, to = alpha[i, first:last], before[i, first:last], part[i, first:last]
        for j in range(last - first):
            change[j] = a[j] + f * (b[j] - a[j])
            detail[j] = excess * (np.float32(was[j]) - level)
        for j in range(last - first):
            change[j] += detail[j]  # apart: rounded before it is added
        for j in range(last - first):
            to[j] = np.int32(min(max(np.float32(to[j]) + v[j] * change[j] + half, none), top))


@kernel()
def not_beyond(
    moved: np.float32, here: np.float32, was: np.float32, skin: np.float32, grey: np.float32, top: np.float32
) -> np.float32:
    """Where a sample of chroma that is `here` ends at most, `moved` else: see `rgb_planes.not_beyond`.

    was, skin: the chroma of the skin in it, and what that becomes;  grey: its code;  top: the largest code.
    """
    one, none = np.float32(1.0), np.float32(0.0)
    size, own = was - grey, here - grey
    faint = (FAINT * top) ** 2
    kept = min(max(((skin - grey) * size + faint) / (size * size + faint), none), one) * own + grey
    return min(max(moved, min(here, skin, kept)), max(here, skin, kept))


@kernel(fastmath=True)
def move_chroma(part: Samples, was: Samples, weight: Floats, change: Floats, grey: np.float32, top: np.float32) -> None:
    """part += weight · change, in place, within `not_beyond`, rounded and held to [0, top]; all (n,)."""
    none, half = np.float32(0.0), np.float32(0.5)
    for j in range(len(part)):
        here, own = np.float32(part[j]), np.float32(was[j])
        moved = not_beyond(here + weight[j] * change[j], here, own, own + change[j], grey, top)
        part[j] = np.int32(min(max(moved + half, none), top))


@kernel(fastmath=True)
def apply_map(
    part: Samples, shown: Shown, alpha: Floats, shift: Grid, fade: Floats, tone: ToneMap, codes: Codes
) -> None:
    """part += α (R(F(before) + w shift) − R(before)), in place: u' = F(I) + H(g' − F(g)), rounded and held to [0, top].

    R is `rolled_off`.  What is here is bounded by what the skin in it becomes, see `rgb_planes.not_beyond`.
    part: (r, c) samples of a plane;  alpha: see `apply_contrast`;  shift: H(g' − F(g));
    fade: (r, c) float32 w, see `fade_in_dark`, without rows it is 1;  tone: F.
    """
    values, tables, excess, bend = shift.values, tone.tables, tone.excess, tone.bend
    before, broad, by, grey, top = shown.before, shown.broad, shown.luma, codes.zero, codes.top
    count, (h, w) = part.shape[1], values.shape
    (index, share), (upper, down) = split(shift.columns, w), split(shift.rows, h)
    change, added = np.empty(count, np.float32), np.empty((2, count), np.float32)
    at, half, none = -2, np.float32(0.5), np.float32(0.0)
    rise, falls, fall = tables[0], len(tables) > 1, tables[len(tables) - 1]
    for i in range(part.shape[0]):
        first, last = whole_run(alpha[i])
        if first >= last:
            continue
        f = down[i]
        at = at if upper[i] == at else reach(values, upper[i], at, index, share, added)
        a, b = added[0, first:last], added[1, first:last]
        v, was, wide, to = alpha[i, first:last], before[i, first:last], broad[i, first:last], part[i, first:last]
        luma = by[i, first:last]
        for j in range(last - first):
            change[j] = a[j] + f * (b[j] - a[j])
        if len(fade):
            kept = fade[i, first:last]
            for j in range(last - first):
                change[j] *= kept[j]
        if not falls:
            for j in range(last - first):
                change[j] += rise[luma[j]] + excess * np.float32(wide[j])
            move_chroma(to, was, v, change[: last - first], grey, top)
            continue
        for j in range(last - first):
            change[j] += rise[wide[j]] + fall[was[j]]
        if len(bend):
            toe, below, knee, above = bend[0], bend[1], bend[2], bend[3]
            for j in range(last - first):
                source = np.float32(was[j])
                wanted = source + change[j]
                change[j] = rolled_off(wanted, toe, below, knee, above) - rolled_off(source, toe, below, knee, above)
        for j in range(last - first):
            here, skin = np.float32(to[j]), np.float32(was[j]) + change[j]
            moved = min(here + v[j] * change[j], max(here, skin))
            to[j] = np.int32(min(max(moved + half, none), top))


@kernel(fastmath=True)
def tinge(
    luma: Samples | Floats,
    blue: Samples | Floats,
    red: Samples | Floats,
    of_blue: Floats,
    of_red: Floats,
    least: Floats,
    grey_blue: np.float32,
    grey_red: np.float32,
    alpha: Floats,
    out: Floats,
) -> None:
    """out (r, c) = α times a smooth step from 0 to 1 of blue · of_blue + red · of_red + least, by luma's code.

    blue, red: (r, c) samples of chroma, grey at `grey_blue` and `grey_red`;  luma: (r, c) where they are;
    alpha: (r, c), where it is 0 nothing is written.
    """
    one, none, most = np.float32(1.0), np.float32(0.0), len(least) - 1
    for i in range(out.shape[0]):
        first, last = whole_run(alpha[i])
        if first >= last:
            continue
        by, b, r, to = luma[i, first:last], blue[i, first:last], red[i, first:last], out[i, first:last]
        v = alpha[i, first:last]
        for j in range(last - first):
            code = min(max(int(by[j]), 0), most)
            of = (np.float32(b[j]) - grey_blue) * of_blue[code] + (np.float32(r[j]) - grey_red) * of_red[code]
            t = min(max(of + least[code], none), one)
            to[j] = t * t * (np.float32(3.0) - np.float32(2.0) * t)
        for j in range(last - first):
            to[j] *= v[j]


@kernel(fastmath=True)
def fade_in_dark(
    luma: Samples | Floats,
    alpha: Floats,
    around: Grid,
    black: np.float32,
    low: np.float32,
    high: np.float32,
    out: Floats,
) -> None:
    """out (r, c) float32 = w(luma / around), both above black: 1 from `high` on, the ratio itself up to `low`.

    F(I) + w H(g' − F(g)) is then F's about the skin, and I g'/g in what is much darker: through black.
    luma: (r, c) samples, or float32;  alpha: (r, c), where it is 0 nothing is written;
    around: the luma of the skin nearby.
    """
    values, count = around.values, out.shape[1]
    h, w = values.shape
    (index, share), (upper, down) = split(around.columns, w), split(around.rows, h)
    held = np.empty((2, count), np.float32)
    at, one, none = -2, np.float32(1.0), np.float32(0.0)
    wide = one / (high - low)
    for i in range(out.shape[0]):
        first, last = whole_run(alpha[i])
        if first >= last:
            continue
        f = down[i]
        at = at if upper[i] == at else reach(values, upper[i], at, index, share, held)
        a, b, source, to = held[0, first:last], held[1, first:last], luma[i, first:last], out[i, first:last]
        for j in range(last - first):
            ratio = max(np.float32(source[j]) - black, none) / max(a[j] + f * (b[j] - a[j]), one)
            t = min(max((ratio - low) * wide, none), one)
            t = t * t * (np.float32(3.0) - np.float32(2.0) * t)
            to[j] = min(one - (one - t) * (one - ratio), one)


@kernel(fastmath=True)
def scale(
    part: Samples, before: Samples, weight: Floats, gain_less_one: np.float32, bend: Floats, codes: Codes
) -> None:
    """part += weight (R(before + (gain − 1)(before − zero)) − R(before)), in place, rounded and held to [0, top].

    R is `rolled_off`.  part, before: (r, c) uint8 or uint16 samples;  weight: (r, c) float32;
    bend: (4,) float32, or empty for none.
    """
    half, none, level, top = np.float32(0.5), np.float32(0.0), codes.zero, codes.top
    for i in range(part.shape[0]):
        first, last = whole_run(weight[i])
        for j in range(first, last):
            source = np.float32(before[i, j])
            change = gain_less_one * (source - level)
            if len(bend):
                wanted = rolled_off(source + change, bend[0], bend[1], bend[2], bend[3])
                change = wanted - rolled_off(source, bend[0], bend[1], bend[2], bend[3])
            part[i, j] = np.int32(min(max(np.float32(part[i, j]) + weight[i, j] * change + half, none), top))


@kernel(fastmath=True)
def mean_above(before: Samples, alpha: Floats, low: Grid) -> float:
    """The mean of before − low over the matte. 0 where the matte is empty."""
    field = np.empty(before.shape, np.float32)
    read_grid(low.values, low.columns, low.rows, field)
    total, mass = np.float64(0.0), np.float64(0.0)
    for i in range(before.shape[0]):
        weight = alpha[i]
        first, last = whole_run(weight)
        of_row, mass_of_row = np.float32(0.0), np.float32(0.0)
        for j in range(first, last):
            of_row += weight[j] * (np.float32(before[i, j]) - field[i, j])
            mass_of_row += weight[j]
        total += of_row
        mass += mass_of_row
    return total / mass if mass > 0.0 else 0.0
