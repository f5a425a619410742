from __future__ import annotations

import cv2
import numpy as np

from pvg.landmarks import detect_faces, fit_landmarks
from pvg.landmarks.detector import box_iou
from scripts.samples import Samples
from tests.gallery.faces import read_rgb
from tests.gallery.pictures import background, pasted


def test_no_face_is_found_in_a_smooth_scene() -> None:
    assert all(fit_landmarks(background(1), found).score < 0.5 for found in detect_faces(background(1)))


def test_tiles_find_the_small_face_of_a_large_frame(head: np.ndarray) -> None:
    small = cv2.resize(head, (90, 90), interpolation=cv2.INTER_AREA)
    frame = pasted(background(2, 1920, 1080), small, 1200, 300)
    meshes = [fit_landmarks(frame, found) for found in detect_faces(frame)]
    hits = [mesh for mesh in meshes if mesh.score > 0.9]
    assert len(hits) == 1
    np.testing.assert_allclose(hits[0].points.mean(axis=0), [1245, 345], atol=6)


def test_every_face_of_a_group_is_found_once(samples: Samples) -> None:
    found = detect_faces(read_rgb(samples.several_faces))
    assert len(found) >= 2
    boxes = np.stack([face.box for face in found])
    for number, box in enumerate(boxes):
        others = np.delete(boxes, number, axis=0)
        assert box_iou(box, others).max() < 0.4
    assert [face.score for face in found] == sorted((face.score for face in found), reverse=True)
