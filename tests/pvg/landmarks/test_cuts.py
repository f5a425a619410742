from __future__ import annotations

import numpy as np
import pytest

from pvg.landmarks.cuts import DISSOLVE_REACH, RESTING_STEPS, Change, CutDetector
from tests.gallery.pictures import background

WHOLE = np.array([0, 0, 1, 1], np.float32)


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


@pytest.mark.parametrize("length", [6, 12, 20])
def test_a_dissolve_is_one_cut_that_is_told_once_it_has_ended(length: int) -> None:
    before, after = background(7).astype(float), background(8).astype(float)
    shares = np.clip((np.arange(80) - 40 + length / 2) / length, 0, 1)
    detector, halves = CutDetector(), {}
    for k, share in enumerate(shares):
        if detector.is_cut((before + share * (after - before)).astype(np.uint8)):
            assert detector.dissolve is not None
            halves[k] = k - detector.dissolve.steps_since(0.5, WHOLE)
    ((told, half),) = halves.items()
    assert shares[told] == 1
    assert told <= 40 + max(DISSOLVE_REACH + 2, length / 2 + RESTING_STEPS)
    assert abs(half - 40) <= 1


def test_a_part_of_a_picture_that_is_wiped_has_a_middle_of_its_own() -> None:
    before, after = background(7), background(8)
    detector = CutDetector(remembered=24)
    for k in range(31):
        edge = round(before.shape[1] * k / 25) if k <= 25 else before.shape[1]
        assert not detector.is_cut(np.concatenate([after[:, :edge], before[:, edge:]], axis=1))
    assert detector.is_another_since(24)
    change = detector.change(24)
    assert change.rests
    assert change.is_over
    for place in (0.2, 0.5, 0.8):
        part = np.array([place - 0.1, 0.2, place + 0.1, 0.8], np.float32)
        assert abs(30 - change.steps_since(0.5, part) - 25 * place) <= 2


def test_a_part_that_stays_goes_over_with_the_last_picture() -> None:
    """A still, or a drawn frame, beside a film that dissolves: its cut is not laid into frames to come."""
    lumas = np.random.default_rng(0).uniform(0, 255, (25, 36, 64)).astype(np.float32)
    lumas[:, :18, :32] = lumas[0, :18, :32]
    change = Change(lumas, 24)
    assert change.steps_since(0.5, np.array([0, 0, 0.5, 0.5], np.float32)) == 0
    assert change.steps_since(0.1, np.array([0, 0, 0.5, 0.5], np.float32)) == 0


def test_a_picture_that_passes_by_has_not_gone_over() -> None:
    scene, detector = np.concatenate([background(seed) for seed in (7, 8)], axis=1), CutDetector(remembered=24)
    for k in range(28):
        x = min(20 * k, 480)
        assert not detector.is_cut(np.ascontiguousarray(scene[:, x : x + 480]))
    assert detector.is_another_since(24)
    assert detector.change(24).rests
    assert not detector.change(24).is_over


@pytest.mark.parametrize("step", [2, 5])
def test_a_dissolve_of_more_frames_in_the_same_time_is_one_cut(step: int) -> None:
    before, after = background(7).astype(float), background(8).astype(float)
    shares = np.clip((np.arange(80 * step) / step - 40 + 10) / 20, 0, 1)
    detector = CutDetector(step=step)
    (cut,) = [
        k for k, share in enumerate(shares) if detector.is_cut((before + share * (after - before)).astype(np.uint8))
    ]
    assert 50 * step < cut <= (50 + RESTING_STEPS) * step


@pytest.mark.parametrize("step", [1, 2, 5])
def test_a_cut_is_found_at_its_frame_at_any_pace(step: int) -> None:
    """Also the one after a cut, and a picture of one frame."""
    scenes = [7] * 12 + [8] * 3 + [9] + [7] * 7
    detector = CutDetector(step=step)
    assert [k for k, seed in enumerate(scenes) if detector.is_cut(background(seed))] == [12, 15, 16]


def test_a_moving_picture_and_a_fade_are_no_dissolves() -> None:
    scene, detector = background(7), CutDetector()
    assert not any(detector.is_cut(np.roll(scene, 6 * k, axis=1)) for k in range(60))
    detector = CutDetector()
    assert not any(detector.is_cut((scene * gain).astype(np.uint8)) for gain in np.linspace(1, 0.1, 30))


def test_light_that_crosses_a_room_leaves_it_the_same_room() -> None:
    """As a leak of light or a passing lamp does, which changes more of the picture than another face in its place."""

    def room(seed: int) -> np.ndarray:
        detail = np.random.default_rng(seed).normal(0, 1, (32, 48, 1)).repeat(10, axis=0).repeat(10, axis=1)
        return np.asarray(background(7) * 0.1 + 90 + 14 * detail)

    def lit_from(room: np.ndarray, place: float) -> np.ndarray:
        light = np.exp(-(((np.arange(480) / 480 - place) / 0.22) ** 2))[None, :, None] * np.array([250, 120, 40])
        return np.asarray(255 - (255 - room) * (1 - 0.8 * light / 255)).astype(np.uint8)

    for seed, another in ((1, False), (2, True)):
        detector = CutDetector(remembered=8)
        cuts = [detector.is_cut(lit_from(room(1 if k < 5 else seed), 0.1 + 0.1 * k)) for k in range(9)]
        assert not any(cuts)
        assert detector.is_another_since(8) == another
