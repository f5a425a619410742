"""What is kept of one face while a clip is vectorised."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pvg.asset import AssetWriter, FaceRecord
from pvg.face import PARTS, Landmarks, layout
from pvg.landmarks import FaceTrack
from pvg.picture import as_picture
from pvg.vectorization.places import Places
from pvg.vectorization.shared_threads import SharedThreads
from pvg.vectorization.stretch import KeyView, Stretch
from pvg.vectorization.vector_face import VectorFace
from tests.gallery.scenes import drawn_face, open_skin, with_cloth


def base(array: np.ndarray) -> np.ndarray:
    """The array whose memory this one is a part of."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def still_rows(landmarks: Landmarks, count: int) -> FaceTrack:
    """A face that holds still and looks into the camera."""
    stacked = np.repeat(landmarks.stacked[None], count, axis=0)
    return FaceTrack(0, Landmarks.unstack(stacked), np.ones(count, np.float32), np.zeros((count, 3), np.float32))


def test_places_of_faces_are_kept_and_no_stretches_of_their_tracks() -> None:
    scene = drawn_face()
    places = Places()
    places.add(0, still_rows(scene.landmarks, 6))
    (place,) = places.near(5)
    np.testing.assert_array_equal(place.stacked, scene.landmarks.stacked)
    held = {id(base(part)): base(part).nbytes for part in (place.points, place.skin_points)}
    assert sum(held.values()) == place.points.nbytes + place.skin_points.nbytes
    assert places.near(6) == []


LIPS = np.array((168.0, 100.0, 96.0))


def with_mouth(rgb: np.ndarray, landmarks: Landmarks, color: np.ndarray) -> np.ndarray:
    """The picture with all between and around its lips of one colour."""
    out = rgb.copy()
    middle = landmarks.points[layout.LIPS_OUTER].mean(axis=0)
    outline = middle + 1.4 * (landmarks.points[layout.LIPS_OUTER] - middle)
    cv2.fillPoly(out, [np.rint(outline).astype(np.int32)], tuple(int(c) for c in color))
    return out


def record_of(
    pictures: list[np.ndarray], landmarks: Landmarks, folder: Path, yaw: np.ndarray | float = 0.0
) -> FaceRecord:
    """What is kept of a still face whose key frame is its first;  yaw: (n,) degrees that are said of its rows."""
    rows, read = still_rows(landmarks, len(pictures)), tuple(as_picture(rgb) for rgb in pictures)
    rows.pose[:, 0] = yaw
    key = KeyView(0, read[0], rows.landmarks[0], None)
    with AssetWriter(folder / "face.pvg") as writer, SharedThreads() as threads:
        face = VectorFace(0, rows, key, threads, mask="landmarks", seed=0, reset=None)
        face.add(Stretch(0, 0, rows, read, np.ones(len(read), np.float32), (), key, True), writer)
        face.finish(writer)
        return face.record(0)


@pytest.mark.parametrize("light", [1.0, 0.8])
def test_lips_under_a_hand_are_known_by_the_first_frame_that_shows_them(tmp_path: Path, light: float) -> None:
    scene = drawn_face()
    own = np.median(scene.rgb[open_skin(scene)], axis=0)
    covered = with_mouth(scene.rgb, scene.landmarks, own * 1.05)
    shown = with_mouth(scene.rgb, scene.landmarks, LIPS) * light
    pictures = [covered] * 10 + [shown.astype(np.uint8)] * 10
    key, *_ = record_of(pictures, scene.landmarks, tmp_path).key_frames
    assert key.frame == 0
    np.testing.assert_allclose(key.parts[PARTS.index("lips")], LIPS, atol=4)


def test_lips_that_are_never_shown_are_no_part(tmp_path: Path) -> None:
    scene = drawn_face()
    covered = with_mouth(scene.rgb, scene.landmarks, np.median(scene.rgb[open_skin(scene)], axis=0) * 1.05)
    (key,) = record_of([covered] * 20, scene.landmarks, tmp_path).key_frames
    assert np.isnan(key.parts[PARTS.index("lips")]).all()
    assert not np.isnan(key.parts[PARTS.index("brows")]).any()


@pytest.mark.parametrize("cloth", [(150, 195, 225), (32, 32, 36), (235, 236, 238)], ids=["blue", "black", "white"])
def test_a_mask_of_cloth_shows_no_lips(tmp_path: Path, cloth: tuple[int, int, int]) -> None:
    scene = drawn_face()
    masked = with_cloth(scene.rgb, scene.landmarks, cloth)
    (key,) = record_of([masked] * 20, scene.landmarks, tmp_path).key_frames
    assert len(key.skin)
    assert np.isnan(key.parts[PARTS.index("lips")]).all()
    assert not np.isnan(key.parts[PARTS.index("brows")]).any()


@pytest.mark.parametrize(("yaw", "keys"), [(0.0, [0, 10]), (40.0, [0])], ids=["seen", "turned away"])
def test_light_that_changes_makes_a_key_frame_of_a_face_that_is_seen_well_alone(
    tmp_path: Path, yaw: float, keys: list[int]
) -> None:
    bright, dim = (drawn_face((80, 65), 60, size=(160, 160), gain=gain) for gain in (1.0, 0.6))
    pictures = [bright.rgb] * 10 + [dim.rgb] * 20
    turned = np.where(np.arange(30) < 8, 0.0, yaw)
    record = record_of(pictures, bright.landmarks, tmp_path, turned)
    assert [key.frame for key in record.key_frames] == keys
