"""A beard keeps its hue, and stays as dark as it is where a look brightens skin.

Hair does not take a look, and mattes end before it, but a beard lies on the face: skin is between its hairs. The map F
makes what is darker than skin brighter with it, so a beard would look washed out and tinted. Where a face has one, the
membrane takes away from its lower half what F adds to the matte's mean colour around a node, by how much less skin it
is than the cheek above it: darker, or with less of the skin's chroma. In light from one side stubble on the lit jaw is
as bright as the cheek in shade, and only greyer than the cheek over it. Its texture keeps the slope of F, and its
border is as soft as the mean. Luma is left to F where a look darkens skin: all of the face then has less light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from pvg._arrays import Floats, Ints, ramp
from pvg.face import layout
from pvg.rendering.blocks import Blocks, codes_at
from pvg.rendering.correction import Correction
from pvg.rendering.map_tables import MapTables

_AROUND = 0.02  # of the face's width, sigma of the mean around a node [by eye: the width of a moustache's edge]
# of what a cheek's skin has, from where a mean of skin and hair is partly to where it is wholly hair [by blind choice;
# measured: lit stubble 0.68, skin in shade 0.8]
_HAIR = (0.9, 0.65)
_CHEEKS = (-0.36, -0.13)  # of the face's width below its centre, nose and all: from below the eyes to the nose's base
_COLUMN, _BESIDE = 0.05, 0.08  # of the face's width: of a column of the cheeks, and sigma of the mean beside it
_COLUMNS = 25  # with the face's middle in the middle one
_SEEN = 0.02  # of the most that is seen of a column: in one with less there is no skin to compare with
_BEGINS = (-0.12, -0.03)  # of the face's width below its centre: the nose's base, above a moustache
_LIPS = 0.03  # of the face's width around their outline that is theirs [by eye]
_HUELESS = 0.1  # of r of `tinge`: what a cheek has less of it, in light of another hue, tells nothing of hair
_BRIGHTER = 8.0  # levels of 255 that F adds, from which on all is done
_KEPT = np.float32(0.9)  # of what F adds, taken away [by blind choice: 0.9 rather than 0.5 or 0]


def with_beard(blocks: Blocks, corrections: Sequence[Correction]) -> list[Correction]:
    """The corrections of one face without what their maps add to a beard;  blocks: of the lattice of all of them."""
    if not any(isinstance(one.contrast, MapTables) and one.contrast.beard > 0 for one in corrections):
        return list(corrections)
    where = _lower_face(blocks)
    nodes = np.flatnonzero(where > 0)
    if not len(nodes):
        return list(corrections)
    means = blocks.means(_AROUND * blocks.axes.width)
    around, cheeks = codes_at(nodes, means), _cheeks_above(blocks, means, nodes)
    most = _KEPT * where.reshape(-1).take(nodes)
    level = np.float32(2.0 ** (blocks.frame.format.depth - 8))
    out = []
    for correction in corrections:
        tables = correction.contrast
        if not isinstance(tables, MapTables) or tables.beard == 0:
            out.append(correction)
            continue
        gained = tables.gained_of(around, around)
        of_chroma = most * (tables.beard * ramp(_like_skin(tables, around, cheeks), *_HAIR))
        of_luma = of_chroma * np.clip(gained[:, 0] / (_BRIGHTER * level), 0.0, 1.0)
        shift = np.empty_like(correction.shift)
        for p, share in enumerate((of_luma, of_chroma, of_chroma)):
            kept, more = (blocks.at_nodes(blocks.filled(nodes, one)) for one in (share, share * gained[:, p]))
            np.subtract(correction.shift[p] * (1 - kept), more, out=shift[p])
        out.append(replace(correction, shift=shift))
    return out


def _like_skin(tables: MapTables, around: Floats, cheeks: Floats | None) -> Floats:
    """(n,) how much of a cheek's luma, and of its chroma for that luma, mean codes (n, 3) have.

    cheeks: (n, 3) mean codes, or None where none is seen: the luma beside the skin's middle one tells alone.
    """
    level = tables.level_of(around[:, 0])
    if cheeks is None:
        return np.asarray(level / tables.middle, np.float32)
    own, skin = (np.maximum(tables.likeness(codes), 0.0) for codes in (around, cheeks))
    lacks = np.maximum(skin - own, 0.0) / np.maximum(skin, _HUELESS)
    return np.asarray(level / np.maximum(tables.level_of(cheeks[:, 0]), 1.0) * (1.0 - lacks), np.float32)


def _cheeks_above(blocks: Blocks, around: Floats, which: Ints) -> Floats | None:
    """(n, 3) the mean codes of the cheeks above the blocks `which` (n,), None where no cheek is seen.

    around: (h, w, 3) mean codes;  where the cheeks end, the last of them goes on.
    """
    low, high = _CHEEKS
    on_cheeks = (blocks.below > low) & (blocks.below < high)
    weight = on_cheeks * (1.0 - blocks.beside) * blocks.alpha
    middle = _COLUMNS // 2
    some = np.flatnonzero(weight)
    if not len(some):
        return None
    column = np.clip(np.rint(blocks.aside.reshape(-1).take(some) / _COLUMN) + middle, 0, _COLUMNS - 1).astype(np.int64)
    own = weight.reshape(-1).take(some)
    weighed = [own, *(own * one for one in codes_at(some, around).T)]
    held = np.stack([np.bincount(column, one, _COLUMNS) for one in weighed], axis=-1)
    sums = np.asarray(cv2.GaussianBlur(held, (1, 0), 0.0, None, _BESIDE / _COLUMN, cv2.BORDER_CONSTANT), np.float64)
    seen = sums[:, 0] > _SEEN * max(float(sums[:, 0].max()), _SEEN)
    if not seen.any():
        return None
    places = (np.flatnonzero(seen) - middle) * _COLUMN
    means = sums[seen, 1:] / sums[seen, :1]
    aside = blocks.aside.reshape(-1).take(which)
    return np.stack([np.interp(aside, places, one) for one in means.T]).astype(np.float32).T


def _lower_face(blocks: Blocks) -> Floats:
    """(h, w) on blocks of nodes: 1 where a beard can be, within the face's oval and off the lips."""
    outline = blocks.placed.data.landmarks.points[layout.LIPS_OUTER]
    lips = blocks.softened(blocks.inside(outline), _LIPS * blocks.axes.width)
    off_lips = 1.0 - np.clip(2.0 * lips, 0.0, 1.0)
    return np.asarray(ramp(blocks.below, *_BEGINS) * (1.0 - blocks.beside) * off_lips, np.float32)
