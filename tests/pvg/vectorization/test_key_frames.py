from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.face import Landmarks, layout
from pvg.landmarks import FaceTrack
from pvg.skin import Matte, SkinTracker, fit_skin_model
from pvg.vectorization.key_frames import best_row, first_good_row, opacity
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb
from tests.gallery.tracks import seen_track, still_track


def test_a_face_that_comes_and_goes_within_a_shot_fades_in_and_out() -> None:
    faded = opacity(seen_track([1.0] * 20), shots=(0,), frame_count=100)
    np.testing.assert_allclose(faded[:6], [0.2, 0.4, 0.6, 0.8, 1.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(faded[-6:], [1.0, 1.0, 0.8, 0.6, 0.4, 0.2], atol=1e-6)


def test_a_face_comes_and_goes_whole_at_a_cut_and_at_the_clips_ends() -> None:
    assert (opacity(seen_track([1.0] * 20), shots=(0, 10, 30), frame_count=100) == 1).all()
    assert (opacity(seen_track([1.0] * 20, first=0), shots=(0,), frame_count=20) == 1).all()
    assert (opacity(seen_track([1.0], first=0), shots=(0,), frame_count=1) == 1).all()
    walked_out = opacity(seen_track([1.0] * 20, first=0), shots=(0,), frame_count=100, walks_out=True)
    assert (walked_out == 1).all()


def test_a_lost_face_fades_out_before_the_loss_and_in_after_it() -> None:
    faded = opacity(seen_track([1.0] * 10 + [0.0] * 3 + [1.0] * 10), shots=(0, 10, 33), frame_count=100)
    assert (faded[10:13] == 0).all()
    np.testing.assert_allclose(faded[5:10], [1.0, 0.8, 0.6, 0.4, 0.2], atol=1e-6)
    np.testing.assert_allclose(faded[13:18], [0.2, 0.4, 0.6, 0.8, 1.0], atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(seen=st.lists(st.booleans(), min_size=1, max_size=40), cut=st.booleans())
def test_opacity_never_steps_by_more_than_a_fifth_and_is_zero_only_where_nothing_is_seen(
    seen: list[bool], cut: bool
) -> None:
    faded = opacity(seen_track([float(s) for s in seen]), shots=(0, 10) if cut else (0,), frame_count=100)
    assert len(faded) == len(seen)
    assert (np.abs(np.diff(faded)) <= 0.2 + 1e-6).all()
    np.testing.assert_array_equal(faded == 0, ~np.array(seen))


def test_the_first_good_frame_is_frontal_and_sure_of_itself() -> None:
    poses = np.array([(0, 0, 0), (50, 0, 0), (10, 5, 0), (0, 0, 0)], np.float32)
    assert first_good_row(seen_track([0.3, 1.0, 1.0, 1.0], poses=poses)) == 2
    assert first_good_row(seen_track([0.3, 0.7, 0.4, 0.2], poses=np.zeros((4, 3), np.float32))) == 1


@pytest.fixture(scope="module")
def portrait(samples: Samples) -> tuple[np.ndarray, FaceTrack]:
    """A portrait and a track of eight frames in which its face stands still."""
    rgb = read_rgb(samples.pale_portrait)
    return rgb, still_track(Landmarks.from_mesh(fit_surest(rgb).points), 8, first=5)


def spoiled(rgb: np.ndarray, points: np.ndarray) -> dict[str, np.ndarray]:
    width = float(np.ptp(points[layout.CONTOUR, 0]))
    hand = rgb.copy()
    x, y = np.rint(points[layout.MOUTH_CORNERS[0]]).astype(int)
    cv2.circle(hand, (int(x), int(y)), round(0.25 * width), (60, 110, 70), -1)
    return {
        "blurred": cv2.GaussianBlur(rgb, (0, 0), 0.03 * width),
        "burnt out": np.clip(rgb.astype(int) * 3, 0, 255).astype(np.uint8),
        "black": (rgb // 24).astype(np.uint8),
        "covered": hand,
    }


@pytest.mark.parametrize("fault", ["blurred", "burnt out", "black", "covered"])
def test_a_reference_takes_a_frame_without_the_fault(portrait: tuple[np.ndarray, FaceTrack], fault: str) -> None:
    rgb, still = portrait
    bad = spoiled(rgb, still.landmarks.points[0])[fault]
    good = (2, 5, 6)
    frames = [(5 + i, rgb if i in good else bad) for i in range(8)]

    def matte_of(row: int, picture: np.ndarray) -> Matte:
        face = still.landmarks[row]
        return SkinTracker(fit_skin_model(picture, face)).step(picture, face)

    assert best_row(still, frames, matte_of) in good


def test_of_frames_without_a_face_the_first_good_one_is_left(portrait: tuple[np.ndarray, FaceTrack]) -> None:
    _, still = portrait

    def matte_of(row: int, picture: np.ndarray) -> Matte:
        raise AssertionError("no frame was shown")

    assert best_row(still, [], matte_of) == 0
