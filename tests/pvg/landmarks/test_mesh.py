from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks, layout
from pvg.landmarks import Mesh
from tests.gallery.faces import fit_surest, read_rgb

MASKS = ("man_cap_beard_dim", "man_fringe_pale", "woman_earrings_bright", "woman_fringe_dark_background")


@pytest.mark.parametrize("name", MASKS)
def test_landmarks_fall_on_their_labels(name: str, media_dir: Path) -> None:
    rgb = read_rgb(media_dir / "masks" / f"{name}.jpg")
    labels = cv2.imread(str(media_dir / "masks" / f"{name}_labels.png"), cv2.IMREAD_GRAYSCALE)
    assert labels is not None
    points = Landmarks.from_mesh(fit_surest(rgb).points).points
    margin = round(0.015 * float(np.ptp(points[layout.CONTOUR, 0])))

    def share(classes: tuple[int, ...], *groups: layout.Indices) -> float:
        wanted = np.isin(labels, classes).astype(np.uint8)
        assert wanted.any()
        grown = cv2.dilate(wanted, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
        x, y = np.rint(points[np.concatenate(groups)]).astype(int).T
        return float(grown[y, x].mean())

    assert share((4, 5), layout.LEFT_EYE, layout.RIGHT_EYE, layout.PUPILS) >= 0.8
    assert share((11, 12, 13), layout.LIPS_OUTER, layout.LIPS_INNER) >= 0.95
    assert share((10,), layout.NOSE_BASE, layout.NOSE_RIDGE) >= 0.95
    # hair over the brows is labelled hair in the two with a fringe
    assert share((2, 3, 17), layout.LEFT_BROW, layout.RIGHT_BROW) >= 0.8


def test_a_mirrored_face_gives_mirrored_landmarks(portrait: np.ndarray, face: Landmarks) -> None:
    flipped = np.ascontiguousarray(portrait[:, ::-1])
    other, last = Landmarks.from_mesh(fit_surest(flipped).points).points[:, 0], portrait.shape[1] - 1
    x = face.points[:, 0]
    width = np.ptp(x[layout.CONTOUR])
    assert np.abs(other[layout.CONTOUR] - (last - x[layout.CONTOUR][::-1])).mean() < 0.02 * width
    left, right = layout.PUPILS
    assert abs(other[left] - (last - x[right])) < 0.02 * width


def test_a_larger_picture_gives_the_same_landmarks(portrait: np.ndarray, mesh: Mesh) -> None:
    large = cv2.resize(portrait, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    points = (fit_surest(large).points + 0.5) / 3 - 0.5
    width = np.ptp(mesh.points[:, 0])
    assert np.linalg.norm(points - mesh.points, axis=1).mean() < 0.01 * width
