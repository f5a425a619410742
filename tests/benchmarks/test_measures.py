from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.quality.measures import color_distance, detail_kept, iou, motion, psnr, wander, warping_errors
from tests.gallery.pictures import texture


def test_the_distance_of_shifted_colours_is_their_shift_seen_from_all_sides() -> None:
    pixels = np.random.default_rng(0).integers(60, 180, (1500, 3))
    assert color_distance(pixels, pixels) == 0.0
    assert color_distance(pixels, pixels + 30) == pytest.approx(30.0, rel=0.15)  # |(30, 30, 30)| / sqrt(3)


def test_the_psnr_of_a_constant_difference_is_exact() -> None:
    picture = texture() // 2
    there = np.zeros(picture.shape[:2], np.bool_)
    there[20:50, 30:60] = True
    assert psnr(picture, picture + 5) == pytest.approx(20 * np.log10(255 / 5), abs=1e-5)
    assert psnr(picture, picture + there[..., None] * np.uint8(5), there) == pytest.approx(34.1514, abs=1e-3)


def test_a_translated_picture_has_no_warping_error_and_a_flicker_has_its_square() -> None:
    before, now = texture(), texture((3, 1))
    everywhere = np.ones(before.shape[:2], np.bool_)
    inner = np.zeros_like(everywhere)
    inner[20:-20, 20:-20] = True
    moved = motion(before, now)
    assert moved.certain[inner].mean() > 0.99
    still = float(np.mean((now.astype(float) - before)[inner] ** 2))
    (error, whole) = warping_errors(before, now, moved, (inner, everywhere))
    assert error < 0.01 * still
    assert whole >= error
    (flicker,) = warping_errors(before, np.clip(now.astype(int) + 6, 0, 255).astype(np.uint8), moved, (inner,))
    assert flicker == pytest.approx(36 + error, rel=0.05)


def test_a_place_without_certain_flow_has_no_warping_error() -> None:
    moved = motion(texture(), texture())
    nowhere = np.zeros(moved.certain.shape, np.bool_)
    assert np.isnan(warping_errors(texture(), texture(), moved, (nowhere,))[0])


def test_a_smooth_shift_keeps_all_detail_and_a_blur_does_not() -> None:
    luma = cv2.cvtColor(texture(), cv2.COLOR_RGB2GRAY).astype(np.float32)
    inner = np.zeros(luma.shape, np.bool_)
    inner[5:-5, 5:-5] = True
    ramp = np.linspace(0, 40, luma.shape[1], dtype=np.float32)[None]
    assert detail_kept(luma, luma + ramp, inner) == pytest.approx(1.0, abs=1e-5)
    assert detail_kept(luma, 1.4 * luma, inner) == pytest.approx(1.0, abs=1e-5)
    assert detail_kept(luma, cv2.GaussianBlur(luma, (0, 0), 4), inner) < 0.9


def test_iou_counts_what_two_masks_share() -> None:
    first, second = np.zeros((10, 10), np.bool_), np.zeros((10, 10), np.bool_)
    assert iou(first, second) == 1.0
    first[:6], second[4:] = True, True
    assert iou(first, second) == pytest.approx(0.2)
    assert iou(first, first) == 1.0


def test_the_wander_is_the_mean_spread_of_the_channels_over_the_frames() -> None:
    assert wander(np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 1.0]])) == pytest.approx(2 / 3)
