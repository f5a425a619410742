"""Soft covers of polygons."""

from __future__ import annotations

import time

import numpy as np

from pvg.face.cover import soft_cover

SQUARE = np.array([[10, 10], [30, 10], [30, 30], [10, 30]], np.float32)


def test_a_cover_is_one_within_and_nothing_far_off() -> None:
    cover, (x, y) = soft_cover(SQUARE, 2.0, (40, 40))
    assert cover[20 - y, 20 - x] > 0.99
    assert cover[0, 0] < 0.01


def test_a_blur_wider_than_all_that_is_asked_for_takes_no_longer() -> None:
    began = time.thread_time()
    cover, _ = soft_cover(100 * SQUARE, 5000.0, (100, 100))
    assert time.thread_time() - began < 5.0
    assert max(cover.shape) <= 6 * 100
