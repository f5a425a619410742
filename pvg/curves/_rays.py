# Compiled functions take their types from the first call.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, no-untyped-call"
"""A compiled kernel that finds where rays leave a matte."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=True)
def last_crossing(matte, center_x, center_y, rays, step, count, out):
    """out (n,) = the distance along each ray (n, 2) at which the matte (h, w) last falls through 1/2, 0 for never.

    The matte is read bilinearly, 0 beyond its cells, at `count` points `step` apart.
    """
    h, w = matte.shape
    for n in range(len(out)):
        beyond, found = np.float32(0.0), np.float32(0.0)
        for s in range(count - 1, -1, -1):
            x, y = center_x + rays[n, 0] * step * s, center_y + rays[n, 1] * step * s
            value = np.float32(0.0)
            if -1.0 < x < w and -1.0 < y < h:
                x0, y0 = int(np.floor(x)), int(np.floor(y))
                fx, fy = np.float32(x - x0), np.float32(y - y0)
                for dy in range(2):
                    for dx in range(2):
                        if 0 <= x0 + dx < w and 0 <= y0 + dy < h:
                            weight = (fx if dx else np.float32(1.0) - fx) * (fy if dy else np.float32(1.0) - fy)
                            value += weight * matte[y0 + dy, x0 + dx]
            if value >= np.float32(0.5):
                share = (value - np.float32(0.5)) / max(value - beyond, np.float32(1e-6))
                found = (np.float32(s) + min(max(share, np.float32(0.0)), np.float32(1.0))) * step
                break
            beyond = value
        out[n] = found
