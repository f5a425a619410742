"""What is kept of one face while a clip is vectorised."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pvg.asset import AssetWriter
from pvg.face import Landmarks
from pvg.landmarks import FaceTrack
from pvg.picture import as_picture
from pvg.vectorization.following import KeyView, Stretch
from pvg.vectorization.vector_face import VectorFace
from tests.gallery.scenes import drawn_face


def base(array: np.ndarray) -> np.ndarray:
    """The array whose memory this one is a part of."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def test_a_face_keeps_its_places_and_no_stretch_of_its_track(tmp_path: Path) -> None:
    scene = drawn_face()
    picture, count = as_picture(scene.rgb), 6
    stacked = np.repeat(scene.landmarks.stacked[None], count, axis=0)
    rows = FaceTrack(0, Landmarks.unstack(stacked), np.ones(count, np.float32), np.zeros((count, 3), np.float32))
    key = KeyView(0, picture, rows.landmarks[0], None)
    face = VectorFace(0, rows, key, method="landmarks", seed=0, reset=None)
    with AssetWriter(tmp_path / "face.pvg") as writer:
        face.add(Stretch(0, 0, rows, (picture,) * count, np.ones(count, np.float32), (), key), writer)
        face.finish(writer)
    place = face.place(5)
    assert place is not None
    np.testing.assert_array_equal(place.stacked, scene.landmarks.stacked)
    held = {id(base(part)): base(part).nbytes for part in (place.points, place.skin_points)}
    assert sum(held.values()) == place.points.nbytes + place.skin_points.nbytes
