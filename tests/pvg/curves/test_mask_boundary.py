from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pvg.curves import BOUNDARY_SAMPLES, boundary_points, boundary_radius
from tests.gallery.faces import made_up_landmarks


@given(st.floats(-0.6, 0.6), st.floats(60, 110))
def test_the_boundary_of_a_disc_about_the_face_is_that_disc(angle: float, radius: float) -> None:
    axes = made_up_landmarks(angle=angle).axes
    y, x = np.mgrid[:330, :330]
    soft = np.clip(radius - np.hypot(x - axes.center[0], y - axes.center[1]) + 0.5, 0, 1).astype(np.float32)
    assert np.abs(boundary_radius(soft, axes) - radius).max() <= 0.2
    hard = (soft >= 0.5).astype(np.float32)
    assert np.abs(boundary_radius(hard, axes) - radius).max() <= 1.0


def test_the_boundary_starts_at_the_chin_however_the_head_is_rolled() -> None:
    for angle in (-0.5, 0.0, 0.5):
        axes = made_up_landmarks(angle=angle).axes
        first = boundary_points(np.full(BOUNDARY_SAMPLES, 100, np.float32), axes)[0]
        np.testing.assert_allclose(first - axes.center, 100 * axes.down, atol=1e-3)


def test_a_ray_that_meets_no_skin_has_radius_zero() -> None:
    assert (boundary_radius(np.zeros((330, 330), np.float32), made_up_landmarks().axes) == 0).all()
