"""The frame of a clip that a reference is taken from: spoiled ones lose, whatever spoils them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks, layout
from pvg.landmarks import FaceTrack
from pvg.skin import Matte, SkinTracker, fit_skin_model
from pvg.vectorization.best_row import best_row
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb
from tests.gallery.tracks import still_track


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
        "under a red lamp": (rgb * np.array((1.0, 0.35, 0.4))).astype(np.uint8),
        "under a blue lamp": (rgb * np.array((0.45, 0.55, 1.0))).astype(np.uint8),
    }


@pytest.mark.parametrize("fault", ["blurred", "burnt out", "black", "covered", "under a red lamp", "under a blue lamp"])
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
