"""The box of a face, and the prior its landmarks give."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.face import Landmarks, layout
from pvg.landmarks import Mesh
from pvg.skin import face_box
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior, face_area, spatial_prior
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb, real_landmarks, turned_landmarks
from tests.gallery.scenes import drawn_face


def test_the_box_holds_all_landmarks_and_a_neck() -> None:
    scene = drawn_face()
    x0, y0, x1, y1 = face_box(scene.landmarks)
    assert (scene.landmarks.stacked > [x0, y0]).all()
    assert (scene.landmarks.stacked < [x1, y1]).all()
    assert y1 > scene.landmarks.points[layout.CHIN, 1] + 0.8 * np.ptp(scene.landmarks.oval[:, 1])


@settings(deadline=None, max_examples=30)
@given(st.floats(0.3, 8), st.floats(-500, 2000), st.floats(-500, 2000), st.floats(-1.2, 1.2), st.integers(0, 2**31))
def test_the_box_moves_and_scales_with_the_face_and_never_jumps(
    scale: float, dx: float, dy: float, roll: float, seed: int
) -> None:
    face = real_landmarks(100, angle=roll).stacked
    box = face_box(Landmarks.unstack(face))
    moved = (face * scale + [dx, dy]).astype(np.float32)
    expected = box * scale + [dx, dy, dx, dy]
    np.testing.assert_allclose(face_box(Landmarks.unstack(moved)), expected, atol=0.02 * scale + 0.01)
    nudged = (face + np.random.default_rng(seed).uniform(-0.1, 0.1, face.shape)).astype(np.float32)
    assert np.abs(face_box(Landmarks.unstack(nudged)) - box).max() < 2.0


@pytest.fixture(scope="module")
def prior() -> SpatialPrior:
    scene = drawn_face()
    return spatial_prior(scene.skin.shape, scene.landmarks)


def test_the_log_odds_are_for_skin_in_the_face_and_against_it_far_away(prior: SpatialPrior) -> None:
    assert prior.log_odds[prior.foreground].min() > 1
    assert prior.log_odds[(prior.outside > 0.4) & (prior.neck == 0)].max() < -3
    assert prior.log_odds.min() == SKIN_PRIOR.regions.least
    assert prior.log_odds.max() == SKIN_PRIOR.regions.most


def test_the_forehead_is_less_certain_than_the_cheeks(prior: SpatialPrior) -> None:
    inner, above, below = (
        cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) / prior.size
        for part in (prior.face, prior.forehead, ~prior.forehead)
    )
    assert prior.log_odds[(above > 0.1) & prior.face].max() <= np.float32(SKIN_PRIOR.head.forehead_most)
    assert prior.log_odds[(below > 0.2) & (inner > 0.16)].min() == pytest.approx(SKIN_PRIOR.head.cheek_most)


def test_ears_lie_beside_the_face_and_the_neck_below_it(prior: SpatialPrior) -> None:
    rows, columns = np.nonzero(prior.ears & ~prior.face)
    face_rows, face_columns = np.nonzero(prior.face)
    middle = face_columns.mean()
    assert (columns < middle).any()
    assert (columns > middle).any()
    assert (np.abs(columns - middle) > 0.25 * np.ptp(face_columns)).all()
    assert face_rows.min() < rows.min() < rows.max() < face_rows.max()
    assert (prior.neck[-1] == 1).all()
    assert (prior.neck[face_rows.min()] == 0).all()


def test_the_regions_nest(prior: SpatialPrior) -> None:
    assert (prior.foreground <= prior.face).all()
    assert (prior.sample <= prior.foreground).all()
    assert (prior.cheeks <= prior.sample).all()
    assert not (prior.sample & prior.features).any()


@pytest.fixture(scope="module")
def mesh(samples: Samples) -> Mesh:
    return fit_surest(read_rgb(samples.portrait))


def area_and_hull(landmarks: Landmarks) -> tuple[np.ndarray, np.ndarray]:
    """(2, h, w) bool: the face as it is seen, and the convex hull of its points."""
    hull = cv2.convexHull(np.concatenate([landmarks.oval, landmarks.points]))
    whole = np.zeros((300, 300), np.uint8)
    cv2.fillPoly(whole, [np.rint(hull * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    return face_area(whole.shape, landmarks), whole > 0


@pytest.mark.parametrize("side", [-1, 1])
def test_the_wall_in_the_hollows_of_a_profile_is_no_face(mesh: Mesh, side: int) -> None:
    landmarks = turned_landmarks(mesh, 65.0 * side)
    face, hull = area_and_hull(landmarks)
    points = landmarks.points
    hollow = cv2.distanceTransform((hull & ~face).astype(np.uint8), cv2.DIST_L2, 5)
    tip = int(points[layout.NOSE_TIP, 1])
    assert hollow[:tip].max() > 2  # before the bridge
    assert hollow[tip:].max() > 2  # below the nose
    near = cv2.dilate(face.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
    x, y = np.rint(points).astype(int).T
    assert near[y, x].all()
    foreground = spatial_prior(face.shape, landmarks).foreground
    assert (foreground <= face).all()


def test_the_hollows_open_by_and_by_as_a_head_turns(mesh: Mesh) -> None:
    for side in (-1, 1):
        pairs = [area_and_hull(turned_landmarks(mesh, float(side * yaw))) for yaw in range(76)]
        hollow = np.array([np.count_nonzero(hull & ~face) / np.count_nonzero(hull) for face, hull in pairs])
        assert hollow[:30].max() < 0.003
        assert hollow[-1] > 0.03
        assert np.abs(np.diff(hollow)).max() < 0.01
