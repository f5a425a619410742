from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.face import Landmarks, layout
from pvg.landmarks import FaceTrack, smooth
from tests.gallery.faces import STACKED_COUNT
from tests.gallery.tracks import track_of

LIPS = np.concatenate([layout.LIPS_OUTER, layout.LIPS_INNER])
UPPER_LID = layout.LEFT_EYE[1:4]  # between the corners


def wobbling(stacked: np.ndarray, score: np.ndarray | None = None) -> FaceTrack:
    """A track whose pose is made of its first points, so that it moves as they do."""
    return track_of(stacked, score, stacked[:, :3, 0])


@pytest.fixture(scope="module")
def shape(face: Landmarks) -> np.ndarray:
    """(194, 2) all points of a real face, 240 px wide."""
    return face.stacked.astype(np.float64) * (240 / np.ptp(face.points[layout.CONTOUR, 0]))


@pytest.mark.parametrize("jitter_px", [0.1, 0.3])
@pytest.mark.parametrize("together", [False, True])
def test_jitter_of_a_still_face_falls_at_least_threefold(shape: np.ndarray, jitter_px: float, together: bool) -> None:
    rng = np.random.default_rng(0)
    noise = jitter_px * rng.standard_normal((100, 1 if together else len(shape), 2))
    track = wobbling(shape + noise)
    calm = smooth(track)
    for name in ("points", "skin_points"):
        before = np.diff(getattr(track.landmarks, name), 2, axis=0).std()
        after = np.diff(getattr(calm.landmarks, name), 2, axis=0).std()
        assert after * 3 < before


@pytest.mark.parametrize("amplitude_px", [4.0, 10.0])
def test_speech_keeps_its_peaks_and_timing(shape: np.ndarray, amplitude_px: float) -> None:
    time_s = np.arange(100) / 25
    motion = amplitude_px * np.sin(2 * np.pi * 4 * time_s)
    points = np.tile(shape, (100, 1, 1))
    points[:, LIPS, 1] += motion[:, None]
    noisy = points + 0.15 * np.random.default_rng(1).standard_normal(points.shape)
    result = smooth(wobbling(noisy)).landmarks.points[:, LIPS, 1].mean(axis=1) - shape[LIPS, 1].mean()
    gain = (result @ motion) / (motion @ motion)
    assert 0.96 < gain < 1.04
    shifts = [float(np.roll(motion, lag)[5:-5] @ result[5:-5]) for lag in (-1, 0, 1)]
    assert int(np.argmax(shifts)) == 1


def test_a_blink_keeps_its_depth_and_its_frame(shape: np.ndarray) -> None:
    points = np.tile(shape, (60, 1, 1)) + 0.1 * np.random.default_rng(2).standard_normal((60, len(shape), 2))
    points[30:33, UPPER_LID, 1] += np.array([5.0, 9.0, 4.0])[:, None]
    result = smooth(wobbling(points)).landmarks.points[:, UPPER_LID, 1].mean(axis=1) - shape[UPPER_LID, 1].mean()
    assert int(result.argmax()) == 31
    assert result.max() > 8.5
    assert np.abs(result[:26]).max() < 0.3


def test_a_steady_turn_is_not_held_back(shape: np.ndarray) -> None:
    drift = np.arange(40)[:, None, None] * np.array([3.0, -1.0])
    track = wobbling(shape + drift)
    calm = smooth(track)
    np.testing.assert_allclose(calm.landmarks.points, track.landmarks.points, atol=2e-3)
    np.testing.assert_allclose(calm.landmarks.skin_points, track.landmarks.skin_points, atol=2e-3)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**16), count=st.integers(1, 40), size=st.floats(0.05, 5))
def test_smoothing_commutes_with_time_reversal(seed: int, count: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    base = rng.uniform(0, 200, (1, STACKED_COUNT, 2))
    points = base + size * rng.standard_normal((count, STACKED_COUNT, 2)).cumsum(axis=0)
    forward = smooth(wobbling(points))
    backward = smooth(wobbling(points[::-1]))
    np.testing.assert_allclose(backward.landmarks.points[::-1], forward.landmarks.points, atol=1e-2)
    np.testing.assert_allclose(backward.pose[::-1], forward.pose, atol=1e-2)


def test_smoothing_does_not_reach_across_a_gap(shape: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    points = shape + 0.2 * rng.standard_normal((60, len(shape), 2))
    score = np.ones(60)
    score[25:30] = 0
    moved = points.copy()
    moved[30:] += 40
    calm = smooth(wobbling(points, score))
    other = smooth(wobbling(moved, score))
    np.testing.assert_array_equal(other.landmarks.points[:25], calm.landmarks.points[:25])
    np.testing.assert_allclose(other.landmarks.points[30:], calm.landmarks.points[30:] + 40, atol=5e-2)
    np.testing.assert_allclose(np.diff(other.landmarks.points[24:31], 2, axis=0), 0, atol=1e-3)
    np.testing.assert_array_equal(other.score, score.astype(np.float32))
