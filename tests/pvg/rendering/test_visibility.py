from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pvg.asset import FaceInFrame
from pvg.curves import BOUNDARY, table_labels
from pvg.face import layout
from pvg.landmarks import Mesh, head_pose
from pvg.rendering.placed_face import PlacedFace, place_face
from pvg.rendering.visibility import _turn, see
from pvg.skin import Matte
from tests.gallery.faces import turned

LABELS = table_labels()
SIZE = (640, 360)


@pytest.fixture(scope="module")
def straight(face: FaceInFrame) -> FaceInFrame:
    return turned(face, 0)


def place(face: FaceInFrame, size: tuple[int, int] = SIZE) -> PlacedFace:
    found = place_face(face, LABELS, *size)
    assert found is not None
    return found


def test_a_face_held_straight_is_seen_whole(straight: FaceInFrame) -> None:
    weight = place(straight).visibility.weight
    inner = LABELS.on_curves("cheek_left", "cheek_right", "nose_bridge", "nose_base", "nose_left", "nose_right")
    assert weight[inner | (LABELS.group != 0)].min() > 0.99
    assert np.mean(weight) > 0.9


def test_the_far_side_fades_as_the_head_turns_and_the_near_side_stays(straight: FaceInFrame) -> None:
    whole = place(straight).visibility.weight
    weights = np.stack([place(turned(straight, yaw)).visibility.weight for yaw in range(0, 91, 5)])
    far = LABELS.on_curves("cheek_right", "eye_right", "brow_right", "nose_right", "lower_cheek_right")
    near = LABELS.on_curves("cheek_left", "eye_left", "brow_left", "nose_left", "lower_cheek_left")
    assert (np.diff(weights[:, far], axis=0) <= 1e-6).all()
    assert np.median(weights[-1, far]) < 0.3
    rim = LABELS.on_curves("ring") & (LABELS.s > 0.15) & (LABELS.s < 0.35)  # about the far ear
    share = weights[:, rim].sum(axis=1) / whole[rim].sum()
    assert share[2] > 0.8  # 10 degrees
    assert share[6] < 0.5  # 30 degrees
    assert share[9] < 0.1  # 45 degrees
    np.testing.assert_allclose(weights[:12, near], np.tile(whole[near], (12, 1)), atol=0.01)  # up to 55 degrees


def test_turning_left_hides_what_turning_right_shows(straight: FaceInFrame) -> None:
    right, left = (place(turned(straight, yaw)).visibility.weight for yaw in (70, -70))
    for a, b in (("cheek_right", "cheek_left"), ("eye_right", "eye_left"), ("nose_right", "nose_left")):
        assert right[LABELS.on_curves(a)].mean() == pytest.approx(left[LABELS.on_curves(b)].mean(), abs=0.1)
        assert right[LABELS.on_curves(a)].mean() < right[LABELS.on_curves(b)].mean()


@pytest.mark.parametrize("roll", [-90.0, 30.0, 90.0, 180.0])
@pytest.mark.parametrize(("yaw", "pitch"), [(0.0, 18.0), (22.0, 13.0), (-50.0, -10.0)])
def test_a_head_that_leans_is_turned_as_far_as_it_is_held_upright(roll: float, yaw: float, pitch: float) -> None:
    def head(lean: float) -> np.ndarray:
        """The pose of a made-up mesh turned by yaw and pitch, then in the picture's plane."""
        points = np.random.default_rng(0).normal(size=(478, 3)) * 0.01  # of a flat face: mirror pairs, chin, forehead
        for left, right in layout.MESH_MIRROR_PAIRS:
            points[left, 0], points[right, 0] = -1.0, 1.0
        points[list(layout.MESH_CHIN), 1], points[list(layout.MESH_FOREHEAD), 1] = 1.0, -1.0
        spin = Rotation.from_euler("xyz", [pitch, -yaw, lean], degrees=True).as_matrix()
        x, y, depth = spin @ points.T
        return head_pose(Mesh(np.stack([x, y], axis=1).astype(np.float32), depth.astype(np.float32), 1.0))

    upright = head(0.0)
    np.testing.assert_allclose(upright[:2], [yaw, pitch], atol=2.0)
    assert _turn(head(roll)) == pytest.approx(_turn(upright), abs=0.5)


def test_samples_outside_the_picture_have_no_say(straight: FaceInFrame) -> None:
    full = place(straight)
    edge = float(np.median(full.positions[:, 0]))
    cut = place(straight, (int(edge), SIZE[1]))
    outside = cut.positions[:, 0] > int(edge) - 1
    assert 0.2 < outside.mean() < 0.8
    assert (cut.visibility.weight[outside] == 0).all()
    inside = cut.positions[:, 0] < edge - 10
    np.testing.assert_array_equal(cut.visibility.weight[inside], full.visibility.weight[inside])
    values = np.zeros((len(LABELS), 1), np.float32)
    values[outside] = 100.0
    assert cut.membrane(values).planes.max() < 1.0


def test_what_covers_the_skin_hides_its_curves(straight: FaceInFrame) -> None:
    """A hand over one cheek: the matte is empty there, and the cheek's curve takes its neighbours' values."""
    cheek = LABELS.on_curves("cheek_left")
    low, high = (place(straight).positions[cheek].min(axis=0) - 6, place(straight).positions[cheek].max(axis=0) + 6)
    (x0, y0), (x1, y1) = np.rint(straight.matte.raster.to_cells(np.stack([low, high]))).astype(int)
    alpha = straight.matte.alpha.copy()
    alpha[y0:y1, x0:x1] = 0
    covered = place(replace(straight, matte=Matte.over(straight.matte.raster.box, alpha)))
    assert np.median(covered.visibility.weight[cheek]) == 0
    features = ~LABELS.on_group("skin")
    np.testing.assert_array_equal(covered.visibility.weight[features], place(straight).visibility.weight[features])
    values = np.where(cheek, 100.0, 10.0).astype(np.float32)[:, None]
    hidden = cheek & (covered.visibility.weight == 0)
    assert np.abs(covered.visibility.settle(values)[hidden] - 10.0).max() < 10.0


@settings(max_examples=30, deadline=None)
@given(yaw=st.floats(-90, 90), level=st.floats(-200, 200), seed=st.integers(0, 99))
def test_settling_is_linear_keeps_constants_and_never_leaves_the_range(
    face: FaceInFrame, yaw: float, level: float, seed: int
) -> None:
    visibility = place(turned(face, yaw)).visibility
    assert visibility.weight.min() >= 0
    assert visibility.weight.max() <= 1
    a, b = np.random.default_rng(seed).uniform(-100, 100, (2, len(LABELS), 2)).astype(np.float32)
    np.testing.assert_allclose(visibility.settle(np.full_like(a, level)), level, atol=1e-3 + 1e-5 * abs(level))
    both = visibility.settle(a + 2 * b)
    np.testing.assert_allclose(both, visibility.settle(a) + 2 * visibility.settle(b), atol=1e-2)
    assert visibility.settle(a).max() <= a.max() + 1e-3
    seen = visibility.weight == 1
    np.testing.assert_array_equal(visibility.settle(a)[seen], a[seen])


def test_a_turn_to_profile_and_back_changes_the_correction_without_a_jump(straight: FaceInFrame) -> None:
    """Each degree of a turn changes the correction by little, though whole curves drop out on the way, and at its
    end everything is as before. The landmarks stand still, so all change is the visibility's."""
    across = place(straight).positions[:, 0]
    values = (100.0 * (across - across.min()) / np.ptp(across)).astype(np.float32)[:, None]  # from 0 to 100
    yaws = [*range(0, 85), *range(84, -1, -1)]
    planes = [place(turned(straight, yaw)).membrane(values, tolerance=0.1).planes[0] for yaw in yaws]
    inside = place(straight).membrane(values).planes[0] > 0
    total = np.abs(planes[84] - planes[0])[inside].max()
    steps = [float(np.abs(b - a)[inside].max()) for a, b in pairwise(planes)]
    assert total > 10.0
    assert max(steps) < 5.0
    np.testing.assert_array_equal(planes[0], planes[-1])


def test_where_nothing_is_seen_every_sample_keeps_its_own_value(straight: FaceInFrame) -> None:
    nothing = np.zeros_like(straight.matte.alpha)
    away = replace(turned(straight, 179), matte=Matte.over(straight.matte.raster.box, nothing))
    visibility = see(away, LABELS, place(straight).positions, *SIZE)
    values = np.random.default_rng(0).uniform(0, 255, (len(LABELS), 3)).astype(np.float32)
    hidden = np.flatnonzero(visibility.weight == 0)
    assert len(hidden) > 500
    assert np.isfinite(visibility.settle(values)).all()


def test_a_boundary_that_runs_along_a_near_hand_has_no_say(straight: FaceInFrame) -> None:
    center = place(straight).positions[LABELS.curve == BOUNDARY].mean(axis=0)
    near = straight.boundary.copy()
    near[48:60] = center + (near[48:60] - center) * 0.2
    weight = place(replace(straight, boundary=near)).visibility.weight[LABELS.curve == BOUNDARY]
    assert weight[50:58].max() < 0.3
