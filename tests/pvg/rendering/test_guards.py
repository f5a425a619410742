from __future__ import annotations

import numpy as np
import pytest

from pvg.asset import FaceInFrame
from pvg.curves import table_labels
from pvg.face import layout
from pvg.rendering.guards import _take_out, guard_gain, guarded_alpha
from pvg.rendering.placed_face import place_face


@pytest.mark.parametrize("height", [0.0, 0.3, 1.5, 12.0])
@pytest.mark.parametrize("place", [20.0, 20.27, 20.5])
def test_a_guard_weighs_as_much_as_the_opening_it_stands_for(height: float, place: float) -> None:
    """Closed lips have no area and no guard, and it grows with what opens, wherever between the pixels that is."""
    sigma, width = 3.0, 30.0
    corners = [(0, 0), (width, 0), (width, height), (0, height)]
    alpha = np.ones((60, 80), np.float32)
    taken = _take_out(alpha, np.array(corners, np.float32) + np.float32(place), sigma, 2)
    assert taken is not None
    x, y, weight = taken
    assert x % 2 == y % 2 == 0
    alpha[y : y + weight.shape[0], x : x + weight.shape[1]] += weight
    np.testing.assert_allclose(alpha, 1.0, atol=1e-6)  # what was taken is what is missing
    alpha[y : y + weight.shape[0], x : x + weight.shape[1]] -= weight
    assert (1.0 - alpha).sum() == pytest.approx((width + 0.25) * (height + 0.25), rel=0.03, abs=2.0)
    assert alpha.min() > 0.96 - height / (2.5 * sigma)
    assert (alpha.min() < 0.05) == (height > 10)


def test_eyes_are_taken_out_only_when_protected_and_the_faces_own_matte_stays(face: FaceInFrame) -> None:
    placed = place_face(face, table_labels(), 640, 360)
    assert placed is not None
    before = placed.alpha.copy()
    assert guarded_alpha(placed, ()) == (placed.alpha, [])
    guarded, guards = guarded_alpha(placed, ("eyes",))
    assert len(guards) == 2
    np.testing.assert_array_equal(placed.alpha, before)
    assert (guarded <= before).all()
    for pupil in face.landmarks.points[layout.PUPILS]:
        x, y = np.rint(pupil - [placed.x, placed.y]).astype(int)
        assert guarded[y, x] < 0.2
        assert before[y, x] > 0.9
    x, y = np.rint(face.landmarks.points[layout.UPPER_LIP_TOP] - [placed.x, placed.y]).astype(int)
    assert guarded[y, x] == before[y, x]
    changed, _ = guarded_alpha(placed, ("eyes",), in_place=True)
    assert changed is placed.alpha
    np.testing.assert_array_equal(changed, guarded)


def test_skin_in_the_mouth_stays_in_the_matte(face: FaceInFrame) -> None:
    placed = place_face(face, table_labels(), 640, 360)
    assert placed is not None
    lattice = placed.lattice()
    middle = face.landmarks.points[layout.LIPS_INNER].mean(axis=0)
    skin = np.zeros((lattice.height, lattice.width), np.float32)
    skin[:, : round((middle[0] - lattice.x) / lattice.step)] = 1  # the left half
    plain, [before] = guarded_alpha(placed, ("teeth",))
    kept, [guard] = guarded_alpha(placed, ("teeth",), skin)
    split = round(float(middle[0])) - placed.x
    beside = 2 * int(np.ceil(lattice.step))
    np.testing.assert_allclose(kept[:, : split - beside], placed.alpha[:, : split - beside], atol=1e-6)
    np.testing.assert_allclose(kept[:, split + beside :], plain[:, split + beside :], atol=1e-6)
    assert 0.2 * before.weight.sum() < guard.weight.sum() < 0.8 * before.weight.sum()


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.5])
def test_a_guard_follows_a_power_of_the_skins_gain(gain: float, face: FaceInFrame) -> None:
    placed = place_face(face, table_labels(), 640, 360)
    assert placed is not None
    luma = np.random.default_rng(0).uniform(80, 120, len(table_labels())).astype(np.float32)
    _, guards = guarded_alpha(placed, ("eyes", "teeth"))
    assert len(guards) == 3
    for guard in guards:
        found = guard_gain(guard, placed, luma, np.float32(gain) * luma)
        assert found == pytest.approx(gain**0.8, rel=0.01)
        assert gain != 1.0 or found == 1.0


def test_an_eye_follows_the_light_on_its_own_side(face: FaceInFrame) -> None:
    placed = place_face(face, table_labels(), 640, 360)
    assert placed is not None
    luma = np.full(len(table_labels()), 100, np.float32)
    left = (placed.positions - face.landmarks.axes.center) @ face.landmarks.axes.across < 0
    one, other = (
        guard_gain(guard, placed, luma, np.where(left, luma / 2, luma)) for guard in guarded_alpha(placed, ("eyes",))[1]
    )
    assert min(one, other) < 0.75
    assert max(one, other) > 0.9
