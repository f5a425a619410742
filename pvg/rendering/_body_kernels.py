"""Compiled kernels that draw the rest of a person's skin: a map of colour by tables."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg._compiled import kernel
from pvg.rendering._kernels import Samples, move_chroma, next_run, rolled_off


@kernel(fastmath=True)
def apply_tone(
    part: Samples, before: Samples, broad: Samples, alpha: Floats, tables: Floats, bend: Floats, top: np.float32
) -> None:
    """part += α (R(before + rise[broad] + fall[before]) − R(before)), in place, rounded and held to [0, top];
    see `rgb_planes.not_beyond`.

    part, before, broad: (h, w) samples of luma, broad the same or smoothed;  alpha: (h, w);
    tables: (2, top + 1), rise and fall: what a tone curve adds, by its slopes above 1 and by those below;
    bend: (4,) of R, see `_kernels.roll_off`.
    """
    half, none = np.float32(0.5), np.float32(0.0)
    rise, fall = tables[0], tables[1]
    toe, below, knee, above = bend[0], bend[1], bend[2], bend[3]
    changes = np.empty(part.shape[1], np.float32)
    for i in range(part.shape[0]):
        first, last = next_run(alpha[i], 0)
        while first < last:
            weight, change = alpha[i, first:last], changes[first:last]
            was, wide, to = before[i, first:last], broad[i, first:last], part[i, first:last]
            for j in range(last - first):
                change[j] = rise[wide[j]] + fall[was[j]]
            for j in range(last - first):
                source = np.float32(was[j])
                wanted = source + change[j]
                change[j] = rolled_off(wanted, toe, below, knee, above) - rolled_off(source, toe, below, knee, above)
            for j in range(last - first):
                here = np.float32(to[j])
                moved = min(here + weight[j] * change[j], max(here, np.float32(was[j]) + change[j]))
                to[j] = np.int32(min(max(moved + half, none), top))
            first, last = next_run(alpha[i], last)


@kernel(fastmath=True)
def apply_chroma(
    part: Samples,
    before: Samples,
    broad: Samples,
    luma: Samples,
    alpha: Floats,
    shift: Floats,
    excess: np.float32,
    beyond: Floats,
    grey: np.float32,
    top: np.float32,
) -> None:
    """part += α (shift[luma] + excess · broad − beyond), in place, rounded and held to [0, top].

    See `rgb_planes.not_beyond`.  part, before, broad: (h, w) samples of chroma, before those of the skin, broad the
    same or smoothed;  luma: smoothed, where they are;  alpha, beyond: (h, w);  shift: (top + 1,);  grey: its code.
    """
    changes = np.empty(part.shape[1], np.float32)
    for i in range(part.shape[0]):
        first, last = next_run(alpha[i], 0)
        while first < last:
            weight, change = alpha[i, first:last], changes[first:last]
            was, wide, to = before[i, first:last], broad[i, first:last], part[i, first:last]
            by, less = luma[i, first:last], beyond[i, first:last]
            for j in range(last - first):
                change[j] = shift[by[j]] + excess * np.float32(wide[j]) - less[j]
            move_chroma(to, was, weight, change, grey, top)
            first, last = next_run(alpha[i], last)


@kernel(fastmath=True)
def beyond_bound(
    luma: Samples | Floats,
    blue: Samples | Floats,
    red: Samples | Floats,
    alpha: Floats,
    grey: Floats,
    usual: Floats,
    bound: Floats,
    kept: np.float32,
    out: Floats,
) -> None:
    """out (2, h, w) = k (e − b(e)), see `bounded`, of samples of chroma (h, w), where α is not 0.

    luma: smoothed, where they are;  grey: (2,) its codes;  usual: (2, n) chroma above grey by luma's code;
    bound: (n,) w by luma's code;  kept: k.
    """
    one, most = np.float32(1.0), usual.shape[1] - 1
    for i in range(alpha.shape[0]):
        first, last = next_run(alpha[i], 0)
        while first < last:
            by, b, r = luma[i, first:last], blue[i, first:last], red[i, first:last]
            to_blue, to_red = out[0, i, first:last], out[1, i, first:last]
            for j in range(last - first):
                code = min(max(int(by[j]), 0), most)
                blue_apart = np.float32(b[j]) - grey[0] - usual[0, code]
                red_apart = np.float32(r[j]) - grey[1] - usual[1, code]
                far = one + bound[code] * (blue_apart * blue_apart + red_apart * red_apart)
                lost = kept * (one - one / np.sqrt(far))
                to_blue[j], to_red[j] = lost * blue_apart, lost * red_apart
            first, last = next_run(alpha[i], last)


@kernel(fastmath=True)
def leave(alpha: Floats, at: tuple[int, int], other: Floats, begin: tuple[int, int], size: tuple[int, int]) -> None:
    """alpha = min(alpha, 1 − other) where both are, in place; at, begin: x, y of the first pixel;  size: x, y."""
    one = np.float32(1.0)
    for i in range(size[1]):
        own, taken = alpha[at[1] + i, at[0] : at[0] + size[0]], other[begin[1] + i, begin[0] : begin[0] + size[0]]
        for j in range(len(own)):
            own[j] = min(own[j], one - taken[j])
