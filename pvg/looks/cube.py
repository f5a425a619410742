"""A look as a table of colour, for grading suites: the map F of its skin as a 3D LUT in the .cube format.

The format is Adobe's "Cube LUT Specification", version 1.0: text, R'G'B' in [0, 1], red running fastest.
"""

from __future__ import annotations

from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.haze import cleared
from pvg.looks.haze import under_haze
from pvg.looks.opponent import luma_of, to_opponent, to_rgb
from pvg.looks.skin_map import SkinMap
from pvg.video import ColorSpace

CUBE_SIZE = 33  # nodes a side
_LUMAS = 18
_ENOUGH = 0.01  # of the pixels, that a luma's median is taken of
_SIZES = (2, 256)  # [Cube LUT Specification, LUT_3D_SIZE]


def remainder_by_luma(skin: SkinMap, strength: float, source: NDArray[Any], drawn: NDArray[Any]) -> Doubles:
    """(n, 3) what F lacks of a drawn skin, luma, B − Y and R − Y by even steps of luma from 0 to 255.

    source, drawn: (m, 3) SDR-referred RGB of pixels before and after. Light and parts differ over a face; the median at
    each luma is what one map of colour can tell of them.
    """
    lacks = to_opponent(np.asarray(drawn, np.float64) - _mapped(skin, strength, np.asarray(source, np.float64)))
    at = np.rint(luma_of(np.asarray(source, np.float64)) / 255.0 * (_LUMAS - 1)).astype(np.intp)
    seen = [k for k in range(_LUMAS) if (at == k).sum() > _ENOUGH * len(at)]
    if not seen:
        return np.zeros((_LUMAS, 3))
    medians = np.array([np.median(lacks[at == k], axis=0) for k in seen])
    return np.stack([np.interp(np.arange(_LUMAS), seen, medians[:, k]) for k in range(3)], axis=1)


def _mapped(skin: SkinMap, strength: float, colors: Doubles) -> Doubles:
    return np.asarray(colors + strength * (skin(colors.astype(np.float32)) - colors))


def check_size(size: int) -> None:
    """Raise ValueError for a number of nodes a side that no cube has."""
    if isinstance(size, bool) or not isinstance(size, Integral) or not _SIZES[0] <= size <= _SIZES[1]:
        raise ValueError(f"a cube has {_SIZES[0]} to {_SIZES[1]} nodes a side, not {size!r}")


def look_cube(
    skin: SkinMap,
    strength: float,
    space: ColorSpace | None,
    size: int = CUBE_SIZE,
    remainder: Doubles | None = None,
    *,
    haze: int = 0,
) -> Floats:
    """F, `strength` of the way, as (size, size, size, 3) float32 in [0, 1], indexed by blue, green, red.

    space: what R'G'B' of the clip stands for, None for SDR; the table takes and gives the clip's own values.
    remainder: see `remainder_by_luma`, added;  haze: levels of it over the clip, see `pvg.haze`.
    """
    check_size(size)
    steps = np.linspace(0.0, 255.0, size)
    blue, green, red = np.meshgrid(steps, steps, steps, indexing="ij")
    own = np.stack([red, green, blue], axis=-1).reshape(-1, 3)
    shown = own if space is None else np.maximum(space.to_sdr(own), 0.0)
    clear = np.maximum(cleared(shown, haze), 0.0)
    new = _mapped(skin, strength, clear)
    if remainder is not None:
        luma, steps = luma_of(clear), np.linspace(0.0, 255.0, len(remainder))
        new += to_rgb(np.stack([np.interp(luma, steps, remainder[:, k]) for k in range(3)], axis=1))
    new = under_haze(shown, clear, new, haze)
    out = new if space is None else space.from_sdr(np.maximum(new, 0.0))
    return np.asarray(np.clip(out / 255.0, 0.0, 1.0).reshape(size, size, size, 3), np.float32)


def write_cube(path: str | Path, table: Floats, title: str) -> None:
    """Write a table (n, n, n, 3), indexed by blue, green, red, as a .cube file; quotes in the title are dropped."""
    lines = [f'TITLE "{title.replace(chr(34), "")}"', f"LUT_3D_SIZE {len(table)}"]
    lines += ["DOMAIN_MIN 0 0 0", "DOMAIN_MAX 1 1 1"]
    lines += [f"{r:.6f} {g:.6f} {b:.6f}" for r, g, b in table.reshape(-1, 3).tolist()]
    Path(path).write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace")
