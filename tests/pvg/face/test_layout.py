from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks, layout
from pvg.landmarks import Mesh
from pvg.landmarks.mesh import region_of_points
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb, rolled

LIP_TOP_LINE = layout.LIPS_OUTER[:7]  # from the left corner over the upper lip to the right one
LOWER_LIP_MIDDLE = layout.LIPS_OUTER[9]
UPPER_EDGE = slice(0, 5)  # of a brow


@pytest.fixture(scope="module")
def mesh(samples: Samples) -> Mesh:
    return fit_surest(read_rgb(samples.dark_portrait))


@pytest.fixture(scope="module")
def face(mesh: Mesh) -> Landmarks:
    return Landmarks.from_mesh(mesh.points)


@pytest.mark.parametrize("name", ["portrait", "dark_portrait", "pale_portrait"])
def test_landmarks_lie_in_anatomical_order(name: str, samples: Samples) -> None:
    fitted = fit_surest(read_rgb(getattr(samples, name)))
    p = Landmarks.from_mesh(fitted.points).points
    assert p.shape == (106, 2)
    assert p.dtype == np.float32
    assert fitted.score > 0.95
    p = rolled(p, -region_of_points(fitted.points).angle).astype(np.float32)  # eyes level
    x, y = p.T
    assert y[layout.UPPER_BROW_EDGES].max() < y[layout.EYE_CONTOURS].min() + 0.02 * np.ptp(y)
    downwards = [*layout.NOSE_RIDGE, layout.NOSE_BASE_MIDDLE, layout.UPPER_LIP_TOP, LOWER_LIP_MIDDLE, layout.CHIN]
    assert y[downwards].tolist() == sorted(y[downwards])
    eye_corners = [*layout.LEFT_EYE_CORNERS, *layout.RIGHT_EYE_CORNERS]
    for rightwards in (layout.LEFT_BROW[UPPER_EDGE], layout.RIGHT_BROW[UPPER_EDGE], eye_corners, LIP_TOP_LINE):
        assert x[rightwards].tolist() == sorted(x[rightwards])
    tip = layout.NOSE_TIP
    around = np.arctan2(x[layout.CONTOUR] - x[tip], y[layout.CONTOUR] - y[tip])  # seen from the nose: left, down, right
    assert around.tolist() == sorted(around)
    assert abs(around[layout.CHIN]) < 0.3
    inner = np.delete(p, layout.CONTOUR, axis=0)
    # the contour closed over the forehead by the outer brow ends, grown by 2 %
    forehead = p[layout.UPPER_BROW_EDGES] - [0, 0.1 * np.ptp(y)]
    hull = cv2.convexHull(np.concatenate([p[layout.CONTOUR], forehead]).astype(np.float32))
    assert all(cv2.pointPolygonTest(hull, (float(a), float(b)), False) > 0 for a, b in inner)
    for pupil, eye in zip(layout.PUPILS, (layout.LEFT_EYE, layout.RIGHT_EYE), strict=True):
        assert cv2.pointPolygonTest(p[eye], (float(x[pupil]), float(y[pupil])), False) > 0


def test_closed_groups_are_simple_loops(face: Landmarks) -> None:
    assert set(layout.LANDMARK_GROUPS) >= layout.CLOSED_GROUPS
    for name in layout.CLOSED_GROUPS:
        loop = face.points[layout.LANDMARK_GROUPS[name]]
        area = abs(cv2.contourArea(loop))
        hull = cv2.contourArea(cv2.convexHull(loop))
        assert area > 0.6 * hull, name  # a wrong order crosses itself and loses area


def test_skin_loops_are_nested_and_disjoint(face: Landmarks) -> None:
    skin = face.skin_points
    assert skin.shape == (layout.SKIN_COUNT, 2) == (88, 2)
    width = float(np.ptp(skin[:, 0]))
    oval, ring, left, right = (skin[part] for part in (layout.OVAL, layout.RING, layout.LEFT_CHEEK, layout.RIGHT_CHEEK))
    assert [len(loop) for loop in (oval, ring, left, right)] == [36, 36, 8, 8]
    assert [len(loop) for loop in layout.SKIN_POINTS.values()] == [36, 36, 8, 8]
    for inside, outside in ((ring, oval), (left, ring), (right, ring)):
        for a, b in inside:
            depth = cv2.pointPolygonTest(outside, (float(a), float(b)), True)
            assert depth > -0.01 * width, (a, b)  # a turned cheek folds the ring onto the oval
    assert cv2.isContourConvex(oval) or cv2.contourArea(oval) > 0.98 * cv2.contourArea(cv2.convexHull(oval))
    assert left[:, 0].max() < right[:, 0].min()


def test_named_groups_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        layout.CONTOUR[0] = 1
