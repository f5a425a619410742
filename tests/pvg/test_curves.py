from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.curves.labels import (
    BOUNDARY,
    BOUNDARY_SAMPLES,
    CURVES,
    boundary_points,
    boundary_radius,
    face_frame,
    labels_by_length,
    place,
    table_labels,
)


def face_points(width: float = 200.0, center: tuple[float, float] = (150.0, 160.0), angle: float = 0.0) -> np.ndarray:
    """194 stacked points: eyes where eyes are, a half-circle jaw, the rest scattered inside the face."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.3, 0.3, (194, 2))
    turn = np.linspace(0, np.pi, 33)
    points[:33] = np.stack([-0.5 * np.cos(turn), 0.6 * np.sin(turn)], axis=1)
    ring = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    eye = 0.06 * np.stack([np.cos(ring), np.sin(ring)], axis=1)
    points[52:58], points[58:64] = eye + np.array([-0.22, -0.15]), eye + np.array([0.22, -0.15])
    c, s = np.cos(angle), np.sin(angle)
    return (points @ np.array([[c, s], [-s, c]]) * width + center).astype(np.float32)


def circle(points: np.ndarray, radius: float) -> np.ndarray:
    return boundary_points(np.full(BOUNDARY_SAMPLES, radius, np.float32), points[:106])


def test_landmark_curves_pass_through_their_landmarks_at_fixed_parameters() -> None:
    points = face_points()
    labels = table_labels()
    positions = place(labels, points, circle(points, 120))
    for c, curve in enumerate(CURVES):
        if not curve.knots:
            continue
        start, stop, closed = labels.spans[c]
        assert closed == curve.closed
        assert stop - start == len(positions[start:stop])
        pairs = [knot if isinstance(knot, tuple) else (knot, knot, 0.0) for knot in curve.knots]
        knots = np.array([(1 - t) * points[i] + t * points[j] for i, j, t in pairs])
        np.testing.assert_allclose(positions[start : stop : curve.per_segment][: len(knots)], knots, atol=1e-3)


def test_the_same_label_is_the_same_place_of_the_face_in_every_pose() -> None:
    """Positions are linear in the landmarks: a similarity of the face is the same similarity of its curves."""
    one, two = face_points(), face_points(width=140.0, center=(90.0, 200.0), angle=0.4)
    positions = place(table_labels(), one, circle(one, 100))
    moved = place(table_labels(), two, circle(two, 70))
    c, s = np.cos(0.4), np.sin(0.4)
    expected = (positions - (150, 160)) * 0.7 @ np.array([[c, s], [-s, c]]) + (90, 200)
    np.testing.assert_allclose(moved, expected, atol=0.02)


@given(st.floats(-0.6, 0.6), st.floats(60, 110))
def test_boundary_of_a_disc_about_the_face_is_that_disc(angle: float, radius: float) -> None:
    points = face_points(angle=angle)[:106]
    center = face_frame(points).center
    y, x = np.mgrid[:330, :330]
    soft = np.clip(radius - np.hypot(x - center[0], y - center[1]) + 0.5, 0, 1).astype(np.float32)
    assert np.abs(boundary_radius(soft, points) - radius).max() <= 0.2
    hard = (soft >= 0.5).astype(np.float32)
    assert np.abs(boundary_radius(hard, points) - radius).max() <= 1.0


def test_boundary_starts_at_the_chin_however_the_head_is_rolled() -> None:
    for angle in (-0.5, 0.0, 0.5):
        points = face_points(angle=angle)
        first = circle(points, 100)[0]
        frame = face_frame(points[:106])
        np.testing.assert_allclose(first - frame.center, 100 * frame.down, atol=1e-3)
        down = np.array([-np.sin(angle), np.cos(angle)])
        np.testing.assert_allclose(frame.down, down, atol=1e-3)


def test_a_ray_that_meets_no_skin_has_radius_zero() -> None:
    points = face_points()[:106]
    assert (boundary_radius(np.zeros((330, 330), np.float32), points) == 0).all()


def test_face_frame_width_is_the_jaw_width() -> None:
    assert face_frame(face_points(width=180.0)[:106]).width == pytest.approx(180.0, rel=1e-3)


def test_chain_labels_keep_the_curves_and_follow_their_length() -> None:
    small, large = face_points(width=100.0), face_points(width=300.0)
    few = labels_by_length(small, circle(small, 60), spacing_px=2.0)
    many = labels_by_length(large, circle(large, 180), spacing_px=2.0)
    assert len(few.spans) == len(many.spans) == len(CURVES)
    assert len(many) == pytest.approx(3 * len(few), rel=0.05)
    start, stop, _ = many.spans[BOUNDARY]
    length = cv2.arcLength(place(many, large, circle(large, 180))[start:stop], True)
    assert (stop - start) * 2.0 == pytest.approx(length, rel=0.02)
