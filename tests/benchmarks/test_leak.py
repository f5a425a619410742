from __future__ import annotations

import numpy as np

from benchmarks.quality.leak import leak_frames
from tests.gallery.pictures import texture


def test_the_leaks_panel_grows_and_leaves_the_person_alone() -> None:
    portrait = texture()
    person = np.zeros(portrait.shape[:2], np.float32)
    person[40:120, 40:120] = 1
    frames = list(leak_frames(portrait, person, 6))
    assert all((frame[person > 0] == portrait[person > 0]).all() for frame in frames)
    brightness = [float(frame[person == 0].mean()) for frame in frames]
    assert brightness == sorted(brightness)
    assert brightness[-1] > brightness[0] + 100
