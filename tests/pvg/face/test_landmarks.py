from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.face import Landmarks, layout
from pvg.raster import Raster
from tests.gallery.faces import made_up_landmarks


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**16), angle=st.floats(-3, 3), scale=st.floats(0.2, 5))
def test_landmarks_and_skin_points_commute_with_affine_maps(seed: int, angle: float, scale: float) -> None:
    mesh = np.random.default_rng(seed).normal(0, 100, (3, 478, 2)).astype(np.float32)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], np.float32)
    shift = np.array([30, -7], np.float32)
    after, before = Landmarks.from_mesh(mesh @ turn + shift), Landmarks.from_mesh(mesh)
    for name in ("points", "skin_points"):
        expected = getattr(before, name) @ turn + shift
        np.testing.assert_allclose(getattr(after, name), expected, atol=2e-3 * scale)


def test_stacking_keeps_every_point() -> None:
    face = made_up_landmarks()
    assert face.points.shape == (layout.LANDMARK_COUNT, 2)
    assert face.skin_points.shape == (layout.SKIN_COUNT, 2)
    again = Landmarks.unstack(face.stacked)
    np.testing.assert_array_equal(again.points, face.points)
    np.testing.assert_array_equal(again.skin_points, face.skin_points)
    np.testing.assert_array_equal(face.oval, face.skin_points[layout.OVAL])


def test_the_rows_of_several_pictures_are_those_of_each() -> None:
    faces = [made_up_landmarks(width=width) for width in (100.0, 150.0, 200.0)]
    together = Landmarks(*(np.stack([getattr(f, name) for f in faces]) for name in ("points", "skin_points")))
    assert len(together) == 3
    for k, face in enumerate(faces):
        np.testing.assert_array_equal(together[k].stacked, face.stacked)
    np.testing.assert_array_equal(together[1:].stacked, together.stacked[1:])


@given(ratio=st.floats(0.1, 8), x=st.floats(-300, 300), y=st.floats(-300, 300))
def test_moving_and_scaling_a_face_takes_its_axes_along(ratio: float, x: float, y: float) -> None:
    face, shift = made_up_landmarks(angle=0.3), np.array([x, y], np.float32)
    moved, scaled = face.moved(shift).axes, face.scaled(ratio).axes
    np.testing.assert_allclose(moved.center, face.axes.center + shift, atol=1e-3)
    # half a pixel of the smaller copy is not half a pixel of the picture
    np.testing.assert_allclose(scaled.center, (face.axes.center + 0.5) * ratio - 0.5, atol=2e-3 * max(ratio, 1))
    for axes, width in ((moved, face.axes.width), (scaled, ratio * face.axes.width)):
        np.testing.assert_allclose(axes.width, width, rtol=1e-4)
        np.testing.assert_allclose(axes.down, face.axes.down, atol=1e-3)


def test_a_face_in_the_cells_of_a_raster_is_where_the_raster_puts_its_points() -> None:
    face = made_up_landmarks()
    raster = Raster(np.array([20.0, 30.0], np.float32), 2.5, (90, 80))
    there = face.in_cells(raster)
    np.testing.assert_array_equal(there.stacked, raster.to_cells(face.stacked))


def test_eyes_and_mouth_are_the_middles_of_their_contours() -> None:
    face = made_up_landmarks()
    left, right, mouth = face.eyes_and_mouth
    np.testing.assert_allclose((left + right) / 2, face.points[layout.EYE_CONTOURS].mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(mouth, face.points[layout.LIPS_OUTER].mean(axis=0), rtol=1e-5)
    assert left[0] < mouth[0] < right[0]
    assert mouth[1] > max(left[1], right[1])
