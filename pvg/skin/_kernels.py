# Compiled functions take their types from the first call.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, no-untyped-call"
"""Compiled kernels of what is computed for every cell of every frame."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=True)
def mixture_share(color, own, hair, precision, least, width, out):
    """out (h, w) = t of color = (1 − t) own + t hair for (h, w, 3) colours; see `pvg.skin.veil`.

    hair: (3,);  precision: (3, 3) symmetric;  least: squared contrast below which a line has no direction;
    width: how far, over the contrast, a mixture lies off the line.
    """
    h, w = out.shape
    none, most = np.float32(0.0), np.float32(1.2)
    p00, p01, p02 = precision[0, 0], precision[0, 1], precision[0, 2]
    p11, p12, p22 = precision[1, 1], precision[1, 2], precision[2, 2]
    for i in range(h):
        for j in range(w):
            x, y, z = hair[0] - own[i, j, 0], hair[1] - own[i, j, 1], hair[2] - own[i, j, 2]
            u, v, s = p00 * x + p01 * y + p02 * z, p01 * x + p11 * y + p12 * z, p02 * x + p12 * y + p22 * z
            length = max(u * x + v * y + s * z, least)
            a, b, c = color[i, j, 0] - own[i, j, 0], color[i, j, 1] - own[i, j, 1], color[i, j, 2] - own[i, j, 2]
            share = min(max((a * u + b * v + c * s) / length, none), most)
            if share > none:
                a, b, c = a - share * x, b - share * y, c - share * z
                off = (
                    p00 * a * a
                    + p11 * b * b
                    + p22 * c * c
                    + np.float32(2.0) * (p01 * a * b + p02 * a * c + p12 * b * c)
                )
                share *= np.exp(-off / (length * width * width))
            out[i, j] = share


@njit(cache=True, nogil=True, fastmath=True)
def skin_odds(lab, center, scale, reach, bins, table, sure, prior, neckness, inside, covered, veil_odds, out):
    """out (h, w) = log-odds of skin of every cell; see `pvg.skin.tracking`.

    lab: (h, w, 3);  center, scale: (3,), bins of `table` are (lab − center) · scale + reach;
    inside: signed distance to the carried edge;  covered: (h, w) veil.
    """
    h, w = out.shape
    none, top = np.float32(0.0), np.float32(bins - 1)
    for i in range(h):
        for j in range(w):
            index = 0
            for k in range(3):
                place = (lab[i, j, k] - center[k]) * scale[k] + reach
                index = index * bins + int(min(max(place, none), top))
            evidence = table[index]
            if sure[i, j]:
                evidence = max(evidence, none)
            carried = min(max(inside[i, j] * np.float32(60.0), np.float32(-6.0)), np.float32(6.0))
            carried *= np.float32(1.0) - np.float32(0.6) * neckness[i, j]
            out[i, j] = np.float32(0.6) * prior[i, j] + carried + evidence - veil_odds * covered[i, j]
