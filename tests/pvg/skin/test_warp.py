"""The warp that carries the key frame's shape."""

from __future__ import annotations

import numpy as np
import pytest

from pvg.skin.warp import rbf_warp, similarity
from tests.gallery.scenes import drawn_face


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return drawn_face().landmarks.stacked[::4]


def test_a_similarity_is_carried_exactly(points: np.ndarray) -> None:
    a, b = 0.9 + 0.3j, 12 - 7j
    moved = a * (points[:, 0] + 1j * points[:, 1]) + b
    target = np.stack([moved.real, moved.imag], axis=1).astype(np.float32)
    np.testing.assert_allclose(similarity(points, target), (a, b), atol=1e-3)
    x, y = rbf_warp((240, 320), points, target)
    rows, columns = np.mgrid[:240, :320]
    expected = a * (columns + 1j * rows) + b
    np.testing.assert_allclose(x, expected.real, atol=0.01)
    np.testing.assert_allclose(y, expected.imag, atol=0.01)


def test_points_that_move_by_themselves_are_followed_closely_and_far_cells_are_not(points: np.ndarray) -> None:
    push = np.exp(-((points[:, 0] - points[:, 0].min()) ** 2) / 40**2)[:, None] * np.array([-4, 2])
    target = (points + push).astype(np.float32)
    x, y = rbf_warp((320, 320), points, target)
    columns, rows = np.rint(points).astype(int).T
    off = np.hypot(x[rows, columns] - target[:, 0], y[rows, columns] - target[:, 1])
    assert off.max() < 1.5
    a, b = similarity(points, target)
    assert abs(x[0, -1] + 1j * y[0, -1] - (a * 319 + b)) < 3
