from __future__ import annotations

import numpy as np

from benchmarks.quality.peers import lab_mean_std, linear_map
from tests.gallery.pictures import texture


def test_the_linear_map_gives_pixels_the_mean_and_covariance_wanted() -> None:
    rng = np.random.default_rng(2)
    mixing = rng.normal(0, 12, (3, 3))
    pixels, wanted = rng.normal(0, 9, (4000, 3)) + 90, rng.normal(0, 1, (5000, 3)) @ mixing + (150, 120, 100)
    matrix, offset = linear_map(pixels, wanted)
    moved = pixels @ matrix.T + offset
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-6)
    np.testing.assert_allclose(moved.mean(axis=0), wanted.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(np.cov(moved.T), np.cov(wanted.T), rtol=0.02, atol=0.1)


def test_lab_mean_and_std_leave_a_picture_matched_to_itself() -> None:
    picture = texture()
    assert np.abs(lab_mean_std(picture, picture).astype(int) - picture).max() <= 1
