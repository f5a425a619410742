# Compiled functions take their types from the first call.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, no-untyped-call"
"""Compiled kernels on landmarks, which are wanted several times a frame and are too few for array operations to pay."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def frame_numbers(points):
    """x and y of the centre, of the downward unit vector, and the width of (106, 2) landmarks; see `face_frame`."""
    left_x, left_y, right_x, right_y = 0.0, 0.0, 0.0, 0.0
    for k in range(6):
        left_x += points[52 + k, 0] / 6
        left_y += points[52 + k, 1] / 6
        right_x += points[58 + k, 0] / 6
        right_y += points[58 + k, 1] / 6
    across_x, across_y = right_x - left_x, right_y - left_y
    length = np.sqrt(across_x**2 + across_y**2)
    down_x, down_y = -across_y / max(length, 1e-6), across_x / max(length, 1e-6)
    x, y = (left_x + right_x) / 2 + down_x * 0.75 * length, (left_y + right_y) / 2 + down_y * 0.75 * length
    low, high = np.inf, -np.inf
    for k in range(33):
        along = (points[k, 0] - x) * down_y - (points[k, 1] - y) * down_x
        low, high = min(low, along), max(high, along)
    return x, y, down_x, down_y, high - low


@njit(cache=True, nogil=True)
def settle(values, fading, weight, share):
    """Values (S, C) float32 with those of the samples `fading` (R,) moved by 1 − weight towards share (R, S) of all.

    Summed in the order of the samples: a channel comes out the same whatever others stand beside it, which a matrix
    product does not promise.
    """
    out = values.copy()
    channels = values.shape[1]
    total = np.empty(channels, np.float32)
    for r in range(len(fading)):
        total[:] = np.float32(0.0)
        for s in range(values.shape[0]):
            part = share[r, s]
            for c in range(channels):
                total[c] += part * values[s, c]
        k = fading[r]
        for c in range(channels):
            out[k, c] += (np.float32(1.0) - weight[k]) * (total[c] - values[k, c])
    return out
