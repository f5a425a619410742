from __future__ import annotations

import numpy as np
import pytest

from pvg.asset import FaceInFrame
from pvg.curves import table_labels
from pvg.face import layout
from pvg.rendering.guards import _take_out, guarded_alpha
from pvg.rendering.placed_face import place_face


@pytest.mark.parametrize("height", [0.0, 0.3, 1.5, 12.0])
@pytest.mark.parametrize("place", [20.0, 20.27, 20.5])
def test_a_guard_weighs_as_much_as_the_opening_it_stands_for(height: float, place: float) -> None:
    """Closed lips have no area and no guard, and it grows with what opens, wherever between the pixels that is."""
    sigma, width = 3.0, 30.0
    corners = [(0, 0), (width, 0), (width, height), (0, height)]
    alpha = np.ones((60, 80), np.float32)
    _take_out(alpha, np.array(corners, np.float32) + np.float32(place), sigma)
    assert (1.0 - alpha).sum() == pytest.approx((width + 0.25) * (height + 0.25), rel=0.03, abs=2.0)
    assert alpha.min() > 0.96 - height / (2.5 * sigma)
    assert (alpha.min() < 0.05) == (height > 10)


def test_eyes_are_taken_out_only_when_protected_and_the_faces_own_matte_stays(face: FaceInFrame) -> None:
    placed = place_face(face, table_labels(), 640, 360)
    assert placed is not None
    before = placed.alpha.copy()
    assert guarded_alpha(placed, ()) is placed.alpha
    guarded = guarded_alpha(placed, ("eyes",))
    np.testing.assert_array_equal(placed.alpha, before)
    assert (guarded <= before).all()
    for pupil in face.landmarks.points[layout.PUPILS]:
        x, y = np.rint(pupil - [placed.x, placed.y]).astype(int)
        assert guarded[y, x] < 0.2
        assert before[y, x] > 0.9
    x, y = np.rint(face.landmarks.points[layout.UPPER_LIP_TOP] - [placed.x, placed.y]).astype(int)
    assert guarded[y, x] == before[y, x]
    changed = guarded_alpha(placed, ("eyes",), in_place=True)
    assert changed is placed.alpha
    np.testing.assert_array_equal(changed, guarded)
