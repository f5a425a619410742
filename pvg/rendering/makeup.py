"""Parts on top of the membrane: each adds its own change where its cover is, and nothing beyond.

Covers are drawn on the lattice's nodes, as fine as the membrane itself, and their changes added to its shift: a pixel
costs no more than without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg._compiled import kernel
from pvg.face import PARTS, Landmarks, add_cover, feather, part_outlines, taken
from pvg.membrane import Lattice
from pvg.rendering.correction import Correction


def with_parts(
    corrections: Sequence[Correction],
    changes: Sequence[Doubles | None],
    landmarks: Landmarks,
    lips: Floats | None = None,
) -> list[Correction]:
    """The corrections of one face, all on one lattice, with the changes of its parts.

    changes: for each correction (P, 3) luma and chroma that each of PARTS gains, code values, or None;
    lips: (h, w) how far each node shows lips, see `pvg.rendering.mouth`; None: wholly.
    """
    if not any(change is not None and change.any() for change in changes):
        return list(corrections)
    lattice = corrections[0].lattice
    covers: dict[int, Floats] = {}  # the same for all looks
    out = []
    for correction, change in zip(corrections, changes, strict=True):
        shift, changed = correction.shift, [] if change is None else np.flatnonzero(change.any(axis=1)).tolist()
        if change is not None and changed:
            shift = shift.copy()
            for p in changed:
                if p not in covers:
                    covers[p] = _cover(PARTS[p], landmarks, lattice, lips)
                add_part(shift, np.asarray(change[p], np.float32), covers[p])
        out.append(replace(correction, shift=shift))
    return out


def _cover(part: str, landmarks: Landmarks, lattice: Lattice, lips: Floats | None) -> Floats:
    """(h, w) float32 in [0, 1], how far a part covers each node of a lattice;  lips: see `with_parts`."""
    cover = np.zeros((lattice.height, lattice.width), np.float32)
    outlines, shares = part_outlines(part, landmarks), taken(part, landmarks)
    add_cover(cover, outlines, (lattice.x, lattice.y), lattice.step, feather(part, landmarks), shares)
    if part == "lips" and lips is not None:
        cover *= lips
    return cover


@kernel()
def add_part(shift: Floats, change: Floats, cover: Floats) -> None:
    """shift (3, h, w) += change (3,) · cover (h, w), in place."""
    for i in range(cover.shape[0]):
        share = cover[i]
        for plane in range(3):
            gained, to = change[plane], shift[plane, i]
            for j in range(len(share)):
                to[j] += gained * share[j]
