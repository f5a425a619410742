"""Light whose colour is not the same over a face."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.quality.measures import iou
from pvg.skin import SkinTracker, fit_skin_model
from pvg.skin.tint import tint_slopes, without_tilt
from tests.gallery.scenes import Scene, drawn_face

LAMPS = {"blue": (0.6, 0.8, 1.2), "warm": (1.1, 0.9, 0.55), "magenta": (1.05, 0.62, 1.05)}


def in_lamp(scene: Scene, left: tuple[float, ...], right: tuple[float, ...]) -> np.ndarray:
    """The scene with a lamp of one colour at the face's left side and of another at its right."""
    low, high = scene.landmarks.oval[:, 0].min(), scene.landmarks.oval[:, 0].max()
    share = np.clip((np.arange(scene.rgb.shape[1]) - low) / (high - low), 0, 1)[:, None]
    light = np.array(left) * (1 - share) + np.array(right) * share
    return np.asarray(np.clip(np.rint(scene.rgb * light), 0, 255), np.uint8)


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("tone", ["tan", "dark"])
def test_a_lamp_that_comes_on_at_one_side_moves_the_matte_no_more_than_noise(lamp: str, tone: str) -> None:
    quiet = drawn_face(tone=tone)
    tracker = SkinTracker(fit_skin_model(quiet.rgb, quiet.landmarks))
    before = tracker.step(quiet.rgb, quiet.landmarks)
    for k in range(6):
        scene, share = drawn_face(tone=tone, seed=k), (k + 1) / 6
        light = tuple(1 + share * (gain - 1) for gain in LAMPS[lamp])
        after = tracker.step(in_lamp(scene, (1.0, 1.0, 1.0), light), quiet.landmarks)
        assert iou(before.mask, after.mask) > 0.97
        assert (after.alpha[before.alpha > 250] < 128).mean() < 0.005


@pytest.mark.parametrize("lamp", LAMPS)
def test_light_of_another_colour_all_over_does_not_move_the_matte(lamp: str) -> None:
    quiet = drawn_face(tone="tan")
    tracker = SkinTracker(fit_skin_model(quiet.rgb, quiet.landmarks))
    before = tracker.step(quiet.rgb, quiet.landmarks)
    after = tracker.step(in_lamp(quiet, LAMPS[lamp], LAMPS[lamp]), quiet.landmarks)
    assert iou(before.mask, after.mask) > 0.97


def test_the_tilt_is_that_of_the_light_whatever_lies_before_a_part_of_the_face() -> None:
    size, across = 100.0, 0.4
    light = np.exp(across * (np.arange(120) - 59.5) / size)
    rgb = np.full((90, 120, 3), (160.0, 120.0, 100.0))
    rgb[..., 2] *= light
    rgb[:, 90:110] = (60, 140, 90)
    slopes = tint_slopes(np.rint(rgb).astype(np.uint8), np.ones((90, 120), bool), size)
    np.testing.assert_allclose(slopes, np.array([[0.0, 0.0], [across, 0.0]]), atol=0.06)


def test_small_tilts_are_left_alone() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (40, 50, 3), np.uint8)
    assert without_tilt(rgb, np.array([[0.05, 0.05], [-0.09, 0.0]]), 30.0) is rgb
