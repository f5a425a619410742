"""The rasters that a face's skin is found on."""

from __future__ import annotations

import pytest

from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import face_box, head_shape
from pvg.skin.rasters import first_raster, learning_raster
from tests.gallery.faces import real_landmarks


@pytest.mark.parametrize("width", [30, 120, 500, 1500])
@pytest.mark.parametrize("bald", [False, True])
def test_a_tracks_raster_has_square_cells_of_a_pixel_or_more_and_a_bounded_size(width: float, bald: bool) -> None:
    face = real_landmarks(width, (900, 900))
    raster = first_raster(face, bald=bald)
    x0, y0, x1, y1 = raster.box
    rows, columns = raster.shape
    assert (y1 - y0) / rows == pytest.approx((x1 - x0) / columns, rel=1e-3)
    assert raster.step >= 1 - 1e-6
    assert max(rows, columns) <= SKIN_PRIOR.tracking.most_cells
    left, top, right, bottom = face_box(face, bald=bald)
    assert max(abs(x0 - left), abs(y0 - top), abs(x1 - right), abs(y1 - bottom)) <= raster.step


@pytest.mark.parametrize("width", [120, 1500])
def test_a_key_frame_is_learned_in_as_many_cells_a_face_size_as_stills(width: float) -> None:
    face = real_landmarks(width, (900, 900))
    cells = head_shape(face).size / learning_raster(face, bald=False).step
    assert cells == pytest.approx(min(SKIN_PRIOR.learning.face_px, head_shape(face).size), rel=1e-6)
