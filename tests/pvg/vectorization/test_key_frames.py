from __future__ import annotations

import numpy as np

from pvg.vectorization.key_frames import first_good_row
from tests.gallery.tracks import seen_track


def test_the_first_good_frame_is_frontal_and_sure_of_itself() -> None:
    poses = np.array([(0, 0, 0), (50, 0, 0), (10, 5, 0), (0, 0, 0)], np.float32)
    assert first_good_row(seen_track([0.3, 1.0, 1.0, 1.0], poses=poses)) == 2
    assert first_good_row(seen_track([0.3, 0.7, 0.4, 0.2], poses=np.zeros((4, 3), np.float32))) == 1
