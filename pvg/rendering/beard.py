"""A beard keeps its hue, and stays as dark as it is where a look brightens skin.

Hair does not take a look, and mattes end before it, but a beard lies on the face: skin is between its hairs. The map F
makes what is darker than skin brighter with it, so a beard would look washed out and tinted. Where a face has one, the
membrane takes away from its lower half what F adds to the matte's mean colour around a node, by how dark that is. Its
texture keeps the slope of F, and its border is as soft as the mean. Luma is left to F where a look darkens skin: all of
the face then has less light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pvg._arrays import Floats, ramp
from pvg.face import layout
from pvg.rendering.blocks import Blocks
from pvg.rendering.correction import Correction
from pvg.rendering.map_tables import MapTables

_AROUND = 0.02  # of the face's width, sigma of the mean around a node [by eye: the width of a moustache's edge]
_BEGINS = (-0.12, -0.03)  # of the face's width below its centre: the nose's base, above a moustache
_LIPS = 0.03  # of the face's width around their outline that is theirs [by eye]
_BRIGHTER = 8.0  # levels of 255 that F adds, from which on all is done
_KEPT = np.float32(0.9)  # of what F adds, taken away [by blind choice: 0.9 rather than 0.5 or 0]


def with_beard(blocks: Blocks, corrections: Sequence[Correction]) -> list[Correction]:
    """The corrections of one face without what their maps add to a beard;  blocks: of the lattice of all of them."""
    if not any(isinstance(one.contrast, MapTables) and one.contrast.beard.any() for one in corrections):
        return list(corrections)
    where = _lower_face(blocks)
    nodes = where > 0
    if not nodes.any():
        return list(corrections)
    around = blocks.means(_AROUND * blocks.axes.width)[nodes]
    level = np.float32(2.0 ** (blocks.frame.format.depth - 8))
    out = []
    for correction in corrections:
        tables = correction.contrast
        if not isinstance(tables, MapTables) or not tables.beard.any():
            out.append(correction)
            continue
        gained = tables.gained_of(around, around)
        share = np.repeat((_KEPT * where[nodes] * tables.beard_at(around[:, 0]))[:, None], 3, axis=1)
        share[:, 0] *= np.clip(gained[:, 0] / (_BRIGHTER * level), 0.0, 1.0)
        shares, added = (np.zeros((*blocks.shape, 3), np.float32) for _ in range(2))
        shares[nodes], added[nodes] = share, share * gained
        kept, more = (np.moveaxis(blocks.at_nodes(one), -1, 0) for one in (shares, added))
        out.append(replace(correction, shift=correction.shift * (1 - kept) - more))
    return out


def _lower_face(blocks: Blocks) -> Floats:
    """(h, w) on blocks of nodes: 1 where a beard can be, within the face's oval and off the lips."""
    outline = blocks.placed.data.landmarks.points[layout.LIPS_OUTER]
    lips = blocks.softened(blocks.inside(outline), _LIPS * blocks.axes.width)
    off_lips = 1.0 - np.clip(2.0 * lips, 0.0, 1.0)
    return np.asarray(ramp(blocks.below, *_BEGINS) * (1.0 - blocks.beside) * off_lips, np.float32)
