"""One face in one frame, ready to be solved and drawn: its matte over whole pixels and its curves on the lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg.asset import FaceFrameData
from pvg.curves import BOUNDARY, CurveLabels, Floats, face_frame, place, stack_points
from pvg.poisson import CurveRaster, Lattice, rasterize_curves
from pvg.skin import Matte


@dataclass(frozen=True, eq=False)
class Region:
    """One face in one frame, ready for any number of looks.

    data: its geometry;  x, y: the source pixel of the region's corner;  alpha: (h, w) float32 matte in [0, 1], h and w
    multiples of the chroma step unless the picture ends there;  raster: its curves on the solver's lattice.
    """

    data: FaceFrameData
    positions: Floats
    x: int
    y: int
    alpha: Floats
    raster: CurveRaster


def open_region(data: FaceFrameData, labels: CurveLabels, width: int, height: int, align: int = 2) -> Region | None:
    """Place a face's curves and matte in a picture of `width` x `height`; None when nothing of it is in the picture."""
    x0, y0 = (max(0, int(np.floor(v)) // align * align) for v in data.box[:2])
    x1 = min(width, -(-int(np.ceil(data.box[2])) // align) * align)
    y1 = min(height, -(-int(np.ceil(data.box[3])) // align) * align)
    if x1 - x0 < 2 or y1 - y0 < 2 or data.score <= 0:
        return None
    matte = Matte(box=data.box, alpha=data.matte, mask=data.matte >= 128)
    alpha = matte.alpha_at(np.arange(x0, x1, dtype=np.float32), np.arange(y0, y1, dtype=np.float32))
    positions = place(labels, stack_points(data.points, data.skin_points), data.boundary)
    active = np.ones(len(labels), np.bool_)
    on_boundary = labels.curve == BOUNDARY  # a ray that met no skin has its sample at the centre
    reach = positions[on_boundary] - face_frame(data.points).center
    active[on_boundary] = np.hypot(reach[:, 0], reach[:, 1]) > 1.0
    raster = rasterize_curves(positions, labels.spans, Lattice.over((x0, y0, x1 - x0, y1 - y0)), active=active)
    return Region(data, positions, x0, y0, alpha, raster)
