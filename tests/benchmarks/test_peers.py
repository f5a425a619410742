from __future__ import annotations

import numpy as np

from benchmarks.quality.peers import fit_linear, fit_mk, fit_reinhard, lab_mean_std, linear_map
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


def test_masked_maps_give_the_reference_its_means_and_leave_a_face_matched_to_itself() -> None:
    rng = np.random.default_rng(3)
    pixels = np.clip(rng.normal((120, 90, 80), 12, (3000, 3)), 0, 255).astype(np.uint8)
    wanted = np.clip(rng.normal((190, 150, 130), 9, (3000, 3)), 0, 255).astype(np.uint8)
    for fit in (fit_linear, fit_mk, fit_reinhard):
        moved = fit(pixels, wanted)(pixels[None].astype(np.float32))[0]
        np.testing.assert_allclose(moved.mean(axis=0), wanted.mean(axis=0), atol=1.0)
        same = fit(pixels, pixels)(pixels[None].astype(np.float32))[0]
        assert np.abs(same - pixels).max() < 0.5
