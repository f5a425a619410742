"""What is grey stays grey: a pixel's chroma is moved as far as the pixel has the skin's chroma.

F adds to a pixel what the chroma of skin gains at its luma. That is right for skin in any shade, but black brows would
turn plum beside reddened skin, grey beards pink, and a collar or hair that the matte takes in by mistake orange. With
m(Y) the chroma that is usual for skin at a luma, and c that of a pixel,

    r = (c · m / |m| + e) / (|m| + e)

is 1 on skin and 0 on what is grey, whatever the clip's light; chroma moves by the share s(r), a smooth step. e makes it
1 where skin itself has hardly any chroma: a grey film is coloured as a whole. In shade of another hue skin is far from
what is usual for it, and s begins lower (`pvg.looks.grey`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.rendering import _kernels as kernels
from pvg.rendering.map_tables import MapTables


def tinged(tables: MapTables, luma: NDArray[Any], chroma: tuple[NDArray[Any], NDArray[Any]], alpha: Floats) -> Floats:
    """α s (r, c) float32 of smoothed chroma samples (r, c).

    luma: (r, c) codes where they are, smoothed;  alpha: (r, c).
    """
    out = np.zeros(alpha.shape, np.float32)
    of_blue, of_red, least = tables.alikeness
    (blue, red), (_, grey_blue, grey_red) = chroma, tables.offset
    kernels.tinge(luma, blue, red, of_blue, of_red, least, grey_blue, grey_red, alpha, out)
    return out


def tinged_codes(tables: MapTables, codes: Floats, alpha: Floats) -> Floats:
    """α s (h, w) of smoothed codes (h, w, 3) of luma and chroma, at the same pixels."""
    luma, blue, red = (np.ascontiguousarray(codes[..., p]) for p in range(3))
    return tinged(tables, luma, (blue, red), alpha)
