from __future__ import annotations

import numpy as np
import pytest

from pvg.landmarks.cuts import CutDetector
from tests.gallery.pictures import background


@pytest.mark.parametrize("change", ["darker", "shifted", "shaken", "noisy"])
def test_exposure_motion_and_noise_are_not_cuts(change: str) -> None:
    scene = background(7)
    other = {
        "darker": (scene * 0.5).astype(np.uint8),
        "shifted": np.roll(scene, 12, axis=1),
        "shaken": np.roll(scene, (scene.shape[0] // 12, scene.shape[1] // 8), axis=(0, 1)),
        "noisy": np.clip(scene + np.random.default_rng(0).normal(0, 15, scene.shape), 0, 255).astype(np.uint8),
    }[change]
    detector = CutDetector()
    assert not detector.is_cut(scene)
    assert not detector.is_cut(other)
    assert detector.is_cut(background(8))


def test_a_fade_to_black_ends_in_a_cut_as_a_flat_picture_is_found_everywhere() -> None:
    detector = CutDetector()
    assert not detector.is_cut(background(7))
    assert detector.is_cut(np.zeros_like(background(7)))
