"""Things that pass in front of a face."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.face import layout
from pvg.skin import SkinTracker, fit_skin_model
from tests.gallery.scenes import alpha_of, drawn_face


@pytest.mark.parametrize("tone", ["pale", "tan", "dark"])
def test_a_coloured_bar_in_front_of_the_face_leaves_the_matte_and_the_skin_comes_back(tone: str) -> None:
    scene = drawn_face(width=150, tone=tone)
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.landmarks))
    columns = np.arange(scene.rgb.shape[1])
    center = int(scene.landmarks.points[layout.CHIN, 0])
    for left in (None, center - 70, center - 40, center - 10, center + 25, None):
        bar = np.zeros(scene.skin.shape, np.bool_)
        if left is not None:
            bar[:, (columns >= left) & (columns < left + 26)] = True
        rgb = scene.rgb.copy()
        rgb[bar] = (40, 110, 170)
        alpha = alpha_of(tracker.step(rgb, scene.landmarks), rgb.shape)
        core = cv2.erode((bar & scene.skin).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        beside = cv2.erode((scene.skin & ~bar).astype(np.uint8), np.ones((13, 13), np.uint8)) > 0
        assert alpha[beside].mean() > 0.93
        assert alpha[core].mean() < 0.12 if core.any() else left is None
