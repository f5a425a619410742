"""Tables of colour, read and applied as a grading suite does."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pvg._arrays import Doubles, Floats


def read_cube(path: str | Path) -> Floats:
    """The table (n, n, n, 3) of a .cube file over [0, 1]."""
    size, values = 0, []
    for line in Path(path).read_text(encoding="ascii").splitlines():
        words = line.split()
        if not words or words[0].startswith("#") or words[0] in ("TITLE", "DOMAIN_MIN", "DOMAIN_MAX"):
            continue
        if words[0] == "LUT_3D_SIZE":
            size = int(words[1])
        else:
            values.append([float(word) for word in words])
    return np.array(values, np.float32).reshape(size, size, size, 3)


def apply_cube(table: Floats, colors: Doubles | Floats) -> Doubles:
    """Colours (n, 3), 0-255, through a table (m, m, m, 3), by trilinear interpolation."""
    place = np.clip(np.asarray(colors, np.float64) / 255.0, 0.0, 1.0) * (len(table) - 1)
    low = np.minimum(place.astype(np.intp), len(table) - 2)
    share = place - low
    out = np.zeros(place.shape)
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, share, 1.0 - share), axis=1)
        r, g, b = (low + np.array(corner)).T
        out += weight[:, None] * table[b, g, r]
    return np.asarray(out * 255.0)
