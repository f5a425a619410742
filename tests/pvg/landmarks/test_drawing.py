from __future__ import annotations

import numpy as np

from pvg.face import Landmarks
from pvg.landmarks import draw_landmarks


def test_drawing_leaves_the_picture_alone_and_marks_the_face(portrait: np.ndarray, face: Landmarks) -> None:
    before = portrait.copy()
    drawn = draw_landmarks(portrait, face.points)
    np.testing.assert_array_equal(portrait, before)
    changed = np.argwhere((drawn != portrait).any(axis=2))[:, ::-1]
    assert len(changed) > 500
    low, high = face.points.min(axis=0), face.points.max(axis=0)
    assert (changed >= low - 6).all()
    assert (changed <= high + 6).all()
