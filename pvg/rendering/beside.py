"""Ears and neck in the face's matte: they keep their light beside the face.

The tone curve of a look stretches the tones of the open skin. An ear or a neck in the face's own shade lies below them,
and the curve, which is steep there for the sake of brows and folds, would make it much darker against the face than it
was. Outside the face's oval the membrane therefore also carries the difference between that curve and the one that
moves skin as the middle of the face is moved (`SkinMap.beside`). It is read at the matte's mean colour around each
node, so that texture and shape keep the face's contrast and nothing has an edge. The change of luma that the face's
curves ask for ends there: it would make the neck brighter than the chest, which has no curves. Their change of chroma
goes on, and evens the neck's own. An ear has no chest to meet. One in deep shade is brightened more than a neck
(`SkinMap.ears`), or it would stay a dark one beside a face made bright. What sets both apart in chroma stays in bounds
(`bounded`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pvg._arrays import Floats, ramp
from pvg.rendering.blocks import Blocks, codes_at
from pvg.rendering.bounded import beyond_bound_of_means
from pvg.rendering.correction import Correction
from pvg.rendering.map_tables import MapTables

_AROUND = 0.03  # of the face's width, sigma of the mean around a node [by eye]
# how far below the face's centre, and above it, an ear begins to end and ends, of the face's width [by eye]
_BELOW, _ABOVE = (0.05, 0.25), (0.45, 0.6)


class BesideTables(NamedTuple):
    """What skin beside the face takes, below its ears and at them."""

    neck: MapTables
    ears: MapTables


def with_beside(
    blocks: Blocks, corrections: Sequence[Correction], beside: Sequence[BesideTables | None]
) -> list[Correction]:
    """The corrections of one face with what ears and neck take instead of their tables' gain.

    blocks: of the lattice of all of them;  beside: for each correction the tables of skin beside the face, or None to
    leave it.
    """
    if all(tables is None for tables in beside):
        return list(corrections)
    nodes = np.flatnonzero(blocks.beside > 0)
    if not len(nodes):
        return list(corrections)
    kept = 1.0 - blocks.at_nodes(blocks.beside)  # of luma's shift
    share, below = (values.reshape(-1).take(nodes) for values in (blocks.beside, blocks.below))
    at_ears = share * _height_of_ears(below)
    around, at_neck = codes_at(nodes, blocks.means(_AROUND * blocks.axes.width)), share - at_ears
    out = []
    for correction, tables in zip(corrections, beside, strict=True):
        own = correction.contrast
        if tables is None or isinstance(own, float):
            out.append(correction)
            continue
        neck, ears = (own.gained_more_by(one, around) for one in tables)
        gained = at_neck * neck + at_ears * ears
        gained[1:] -= share * beyond_bound_of_means(tables.neck, around)  # as much at the ears
        shift = correction.shift.copy()
        shift[0] *= kept
        for p, more in enumerate(gained):
            shift[p] += blocks.at_nodes(blocks.filled(nodes, more))
        out.append(replace(correction, shift=shift))
    return out


def _height_of_ears(below: Floats) -> Floats:
    """1 at the height of the ears, 0 well above and below them;  below: of the face's width below its centre."""
    return np.asarray((1.0 - ramp(below, *_BELOW)) * (1.0 - ramp(-below, *_ABOVE)), np.float32)
