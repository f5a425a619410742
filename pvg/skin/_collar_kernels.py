"""Compiled kernels of what tells a collar from skin; see `pvg.skin.collar`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pvg._arrays import Bytes, Floats
from pvg._compiled import kernel
from pvg.skin._kernels import cubic


class Around(NamedTuple):
    """Sums over the sure skin around each cell, (h, w) float32: how much there is, its luma and its chroma."""

    mass: Floats
    luma: Floats
    chroma: Floats


class Rises(NamedTuple):
    """Where two certainties begin to rise from 0 to 1, and over how much: of the luma and of the chroma over skin's.

    mass, luma: what less of is none.
    """

    brighter: np.float32
    brighter_width: np.float32
    paler: np.float32
    paler_width: np.float32
    mass: np.float32
    luma: np.float32


@kernel()
def of_inner(rgb: Floats, luma: Floats, inner: Bytes, rises: Rises, chroma: Floats, sure: Floats) -> None:
    """chroma (h, w) = how far R and B of rgb (h, w, 3) are from the luma (h, w), over it.

    sure (3, h, w): 1, luma and chroma where `inner` (h, w) is 1, else 0.
    """
    for i in range(luma.shape[0]):
        for j in range(luma.shape[1]):
            level = luma[i, j]
            red, blue = np.float64(rgb[i, j, 0] - level), np.float64(rgb[i, j, 2] - level)
            chroma[i, j] = np.float32(np.sqrt(red * red + blue * blue)) / max(level, rises.luma)
            share = np.float32(inner[i, j])
            sure[0, i, j], sure[1, i, j], sure[2, i, j] = share, share * level, share * chroma[i, j]


@kernel()
def brighter_and_paler(
    luma: Floats, chroma: Floats, inner: Bytes, around: Around, below: Floats, rises: Rises, out: Floats
) -> bool:
    """out (h, w) = how surely cells beside sure skin are brighter and paler than it; whether any is.

    luma, chroma: (h, w) of the cells;  inner: (h, w), 1 on sure skin;  below: (h, w) in [0, 1], where collars may be.
    """
    one, found = np.float32(1.0), False
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = np.float32(0.0)
            mass = around.mass[i, j]
            if inner[i, j] or mass <= rises.mass:
                continue
            known = max(mass, rises.mass)
            luma_over = luma[i, j] * known / max(around.luma[i, j], rises.mass)
            brighter = cubic((luma_over - rises.brighter) / rises.brighter_width)
            chroma_over = chroma[i, j] * known / max(around.chroma[i, j], rises.mass * rises.mass)
            paler = one - cubic((chroma_over - rises.paler) / rises.paler_width)
            out[i, j] = brighter * paler * below[i, j]
            found |= out[i, j] != np.float32(0.0)
    return found
