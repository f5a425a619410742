"""The correction of one look in one face: u' = λI + H(g' − λg), the solution of eq. (1) for new boundary colours.

H is the harmonic extension from the curves γ into the face. With f the Laplacian of the clip itself (eq. 4), the u'
with Δu' = λf inside and u' = g' on γ is λI + H(g' − λg): the clip with its contrast scaled by λ and a smooth membrane
added. It is affine in every pixel, so it is taken in luma and chroma, the planes that clips are coded in.

λ is called *contrast* everywhere, from the request down to the kernels: a number, or a field that follows what the
look asks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pvg._arrays import Floats
from pvg.membrane import TOLERANCE, Lattice
from pvg.rendering.placed_face import PlacedFace

_HIGHEST_DETAIL = 128.0  # levels of I − black that a field of λ multiplies: how much finer than H(g') it is solved

Contrast = float | Floats


@dataclass(frozen=True, eq=False)
class CurveCorrection:
    """A correction where it is known: at the S samples of the curves.

    shift: (S, 3) float32 g' − λg of luma and chroma, code values;
    contrast: λ, or (S, 2) float32, λ of luma and of chroma.
    """

    shift: Floats
    contrast: Contrast


@dataclass(frozen=True, eq=False)
class Correction:
    """A correction over a face, on the nodes of a lattice.

    shift: (3, h, w) float32 H(g' − λg) of luma and chroma, code values;
    contrast: λ, or (2, h, w) float32, λ of luma and of chroma extended harmonically;
    low: (3, h, w) float32 H(g), there when λ is a number other than 1.
    """

    lattice: Lattice
    shift: Floats
    contrast: Contrast
    low: Floats | None = None

    def contrast_field(self, plane: int) -> Floats | None:
        """The nodes (h, w) of λ for luma (plane 0) or chroma; None when λ is a number."""
        return None if isinstance(self.contrast, float) else self.contrast[min(plane, 1)]

    @property
    def contrast_number(self) -> float:
        """λ when it is a number; 1 beside a field."""
        return self.contrast if isinstance(self.contrast, float) else 1.0


def at_curves(g: Floats, new: Floats, contrast: Contrast) -> CurveCorrection:
    """What a look asks for at the curves.

    g, new: (S, 3) luma and chroma of the boundary colours g and g', code values;  contrast: λ, or (S, 2).
    """
    if isinstance(contrast, float):
        return CurveCorrection(new - contrast * g, contrast)  # g' − λg on γ, eq. (1)
    return CurveCorrection(new - contrast[:, [0, 1, 1]] * g, contrast)


def extend(face: PlacedFace, g: Floats, wanted: Sequence[CurveCorrection], *, level: float) -> list[Correction]:
    """Extend corrections from the curves into a face; all of them share one operator and one solve.

    g: (S, 3) luma and chroma of the boundary colours;  level: code values a level of 255.
    """
    low_wanted = any(isinstance(one.contrast, float) and one.contrast != 1.0 for one in wanted)
    values: list[Floats] = [g] if low_wanted else []
    tolerance: list[float] = [TOLERANCE * level] * (3 * low_wanted)
    for one in wanted:
        values.append(one.shift)
        tolerance += [TOLERANCE * level] * 3
        if not isinstance(one.contrast, float):
            values.append(one.contrast)
            tolerance += [TOLERANCE * level / _HIGHEST_DETAIL] * 2
    membrane = face.membrane(np.concatenate(values, axis=1), tolerance=np.array(tolerance, np.float32))
    planes = iter(np.split(membrane.planes, np.cumsum([v.shape[1] for v in values])[:-1]))
    low = next(planes) if low_wanted else None
    out = []
    for one in wanted:
        shift = next(planes)
        if isinstance(one.contrast, float):
            out.append(Correction(membrane.lattice, shift, one.contrast, low))
        else:
            out.append(Correction(membrane.lattice, shift, next(planes)))
    return out
