"""Things that pass in front of a face."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.face import layout
from pvg.skin import SkinTracker, fit_skin_model
from tests.pvg.skin.faces import alpha_of, draw_scene


@pytest.mark.parametrize("tone", ["pale", "tan", "dark"])
def test_a_coloured_bar_in_front_of_the_face_leaves_the_matte_and_the_skin_comes_back(tone: str) -> None:
    scene = draw_scene(width=150, tone=tone)
    tracker = SkinTracker(fit_skin_model(scene.rgb, scene.landmarks))
    columns = np.arange(scene.rgb.shape[1])
    center = int(scene.landmarks.points[layout.CHIN, 0])
    for left in (None, center - 70, center - 40, center - 10, center + 25, None):
        bar = np.zeros(scene.truth.shape, np.bool_)
        if left is not None:
            bar[:, (columns >= left) & (columns < left + 26)] = True
        rgb = scene.rgb.copy()
        rgb[bar] = (40, 110, 170)
        alpha = alpha_of(tracker.step(rgb, scene.landmarks), rgb.shape)
        core = cv2.erode((bar & scene.truth).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
        beside = cv2.erode((scene.truth & ~bar).astype(np.uint8), np.ones((13, 13), np.uint8)) > 0
        assert alpha[beside].mean() > 0.93
        assert alpha[core].mean() < 0.12 if core.any() else left is None
