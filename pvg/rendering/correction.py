"""The correction of one look in one face: u' = λI + H(g' − λg), the solution of eq. (1) for new boundary colours.

H is the harmonic extension from the curves γ into the face. With f the Laplacian of the clip itself (eq. 4), the u'
with Δu' = λf inside and u' = g' on γ is λI + H(g' − λg): the clip with its contrast scaled by λ and a smooth membrane
added. It is affine in every pixel, so it is taken in luma and chroma, the planes that clips are coded in.

λ is called *contrast* everywhere, from the request down to the kernels, and is a number. Where the look has one smooth
map F of colour and no number is asked for, F takes the place of the product with λ,

    u' = F(I) + H(g' − F(g)),

which is the same for a linear F of slope λ: every tone then has F's own slope, and the membrane is left with what no
map of colour tells, the place of light. A number other than 1 scales I − H(g) about its mean over the face, so that it
changes contrast alone (docs/decisions/0051): on γ, u' is then g' but for that mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pvg._arrays import Floats
from pvg.membrane import TARGET_HEIGHT, TOLERANCE, Lattice
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_face import PlacedFace

MAPPED_HEIGHT = 128
"""Nodes along a face's height on which maps are solved. What H has to carry beside F is a third as large as g' − λg,
and so is its error. [measured: six looks, mean error in luma 0.02 to 0.18 levels, with λ and 208 nodes 0.03 to 0.22]"""

ContrastOrMap = float | MapTables
"""λ, or the tables of F, which stands for λ then."""


@dataclass(frozen=True, eq=False)
class CurveCorrection:
    """A correction where it is known: at the S samples of the curves.

    shift: (S, 3) float32 g' − λg of luma and chroma, code values.
    """

    shift: Floats
    contrast: ContrastOrMap

    @property
    def mapped(self) -> bool:
        """Whether F stands for λ."""
        return isinstance(self.contrast, MapTables)


@dataclass(frozen=True, eq=False)
class Correction:
    """A correction over a face, on the nodes of a lattice.

    shift: (3, h, w) float32 H(g' − λg) of luma and chroma, code values;
    low: (3, h, w) float32 H(g), there when λ is a number other than 1;
    around: (h, w) float32 H(g) of luma above black, there with F: what is much darker than it is no skin, see `planes`.
    """

    lattice: Lattice
    shift: Floats
    contrast: ContrastOrMap
    low: Floats | None = None
    around: Floats | None = None

    @property
    def mapped(self) -> bool:
        """Whether F stands for λ; a number is the paper's."""
        return isinstance(self.contrast, MapTables)


def at_curves(g: Floats, new: Floats, contrast: ContrastOrMap) -> CurveCorrection:
    """What a look asks for at the curves.

    g, new: (S, 3) luma and chroma of the boundary colours g and g', code values.
    """
    if isinstance(contrast, MapTables):
        skin = np.float32(1.0) - contrast.foreign_at_curves(g)[:, None]
        return CurveCorrection(skin * (new - (g + contrast.gained(g))), contrast)  # g' − F(g)
    return CurveCorrection(new - contrast * g, contrast)  # g' − λg on γ, eq. (1)


def extend(face: PlacedFace, g: Floats, wanted: Sequence[CurveCorrection], *, level: float) -> list[Correction]:
    """Extend corrections from the curves into a face, onto its lattice.

    Those with λ share one operator and one solve, those with F another one on fewer nodes.
    g: (S, 3) luma and chroma of the boundary colours;  level: code values a level of 255.
    """
    tolerance, lattice = TOLERANCE * level, face.lattice()
    mapped = iter(_extended(face, g[:, :1], [one for one in wanted if one.mapped], tolerance, MAPPED_HEIGHT))
    numbers = [one for one in wanted if not one.mapped]
    low_wanted = any(one.contrast != 1.0 for one in numbers)
    others = iter(_extended(face, g if low_wanted else g[:, :0], numbers, tolerance, TARGET_HEIGHT))
    out = []
    for one in wanted:
        low, shift = next(mapped if one.mapped else others)
        if one.mapped:
            out.append(Correction(lattice, shift, one.contrast, around=low[0]))
        else:
            out.append(Correction(lattice, shift, one.contrast, low if low_wanted else None))
    return out


def _extended(
    face: PlacedFace, low: Floats, wanted: Sequence[CurveCorrection], tolerance: float, nodes: int
) -> list[tuple[Floats, Floats]]:
    """For each of some corrections H of `low` (S, C) and of its shift, on the nodes of the face's lattice.

    nodes: that are solved, see `PlacedFace.lattice`.
    """
    if not wanted:
        return []
    membrane = face.membrane(
        np.concatenate([low, *(one.shift for one in wanted)], axis=1), tolerance=tolerance, nodes=nodes
    )
    lattice, first = face.lattice(), low.shape[1]
    planes = (membrane if membrane.lattice == lattice else membrane.on(lattice)).planes
    return [(planes[:first], planes[k : k + 3]) for k in range(first, len(planes), 3)]
