from __future__ import annotations

import numpy as np
import pytest

from pvg.face import FaceAxes, layout
from tests.gallery.faces import made_up_landmarks


def test_the_width_is_the_jaws() -> None:
    assert made_up_landmarks(width=180.0).axes.width == pytest.approx(180.0, rel=1e-3)


@pytest.mark.parametrize("angle", [-0.5, 0.0, 0.5])
def test_the_axes_turn_with_the_head(angle: float) -> None:
    axes = made_up_landmarks(angle=angle).axes
    np.testing.assert_allclose(axes.down, [-np.sin(angle), np.cos(angle)], atol=1e-3)
    np.testing.assert_allclose(axes.across, [np.cos(angle), np.sin(angle)], atol=1e-3)


def test_the_centre_is_below_the_eyes_by_three_quarters_of_their_distance() -> None:
    points = made_up_landmarks().points
    left, right = (points[eye].mean(axis=0) for eye in (layout.LEFT_EYE_CONTOUR, layout.RIGHT_EYE_CONTOUR))
    expected = (left + right) / 2 + [0, 0.75 * (right - left)[0]]
    np.testing.assert_allclose(FaceAxes.of(points).center, expected, atol=1e-3)


def test_landmarks_all_in_one_place_still_have_finite_axes() -> None:
    axes = FaceAxes.of(np.full((layout.LANDMARK_COUNT, 2), 7.0, np.float32))
    assert np.isfinite([*axes.center, *axes.down, *axes.across, axes.width]).all()
    assert axes.width == 0
