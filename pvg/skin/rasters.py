"""The rasters that a face's skin is found on: cells over its box, on its key frame and along its track."""

from __future__ import annotations

from pvg._arrays import Floats
from pvg.face import Landmarks
from pvg.raster import Raster
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import face_box, head_shape

_TRACKING = SKIN_PRIOR.tracking


def first_raster(landmarks: Landmarks, *, bald: bool = False) -> Raster:
    """The raster for a track that starts with these landmarks, of a head that is ``bald`` up to its crown."""
    box = face_box(landmarks, bald=bald)
    width, height = (float(v) for v in box[2:] - box[:2])
    longer = max(width, height)
    cells = min(_TRACKING.most_cells, max(_TRACKING.least_cells, longer / _TRACKING.cell_px))
    return _raster_of(box, max(1.0, longer / cells))


def learning_raster(landmarks: Landmarks, *, bald: bool) -> Raster:
    """The raster a key frame is learned on: as fine as stills are cut, whatever the track's."""
    step = max(1.0, head_shape(landmarks).size / SKIN_PRIOR.learning.face_px)
    return _raster_of(face_box(landmarks, bald=bald), step)


def _raster_of(box: Floats, step: float) -> Raster:
    """Cells of `step` pixels over a box (4,)."""
    rows, columns = (max(_TRACKING.least_side, round(float(box[k + 2] - box[k]) / step)) for k in (1, 0))
    return Raster.centered(box, step, (rows, columns))
