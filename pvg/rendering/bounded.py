"""What sets skin beside the face apart from it stays in bounds.

Ears are redder than their face, hands pinker, a neck yellower. Nobody minds while the face is reddish itself, but with
another's complexion it would stand between crimson ears. With e = c − m(Y), which is what the chroma c of a pixel has
beyond the usual for skin of its luma, the map that moves skin beside the face keeps k b(e) of it instead of k e,

    b(e) = e / √(1 + w |e|²)

w grows with how far a look moves the face, and is 0 where it leaves the face as it is. It falls to 0 in deep shade: the
hollow of an ear is a deep red on every face, and would turn grey.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.rendering import _body_kernels as kernels
from pvg.rendering.map_tables import MapTables


def beyond_bound(
    tables: MapTables, k: float, luma: NDArray[Any], chroma: tuple[NDArray[Any], NDArray[Any]], alpha: Floats
) -> Floats:
    """k (e − b(e)), (2, r, c) float32, of smoothed chroma samples (r, c) where alpha (r, c) is not 0; 0 elsewhere.

    k: `MapTables.spread` or `MapTables.broad`;  luma: (r, c) codes where they are, smoothed.
    """
    out = np.zeros((2, *alpha.shape), np.float32)
    if tables.bound.any():
        grey, share = tables.offset[1:], np.float32(k)
        kernels.beyond_bound(luma, *chroma, alpha, grey, tables.usual, tables.bound, share, out)
    return out


def beyond_bound_of_means(tables: MapTables, codes: Floats) -> Floats:
    """The same (2, n) of mean codes (n, 3) of luma and chroma, with the k of patches."""
    luma, blue, red = (np.ascontiguousarray(codes[None, :, p]) for p in range(3))
    everywhere = np.ones((1, len(codes)), np.float32)
    return beyond_bound(tables, tables.broad, luma, (blue, red), everywhere)[:, 0]
