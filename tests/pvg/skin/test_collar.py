"""Collars on a drawn neck."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from pvg.skin.collar import collar
from pvg.skin.prior import HeadShape, head_shape
from tests.gallery.scenes import drawn_face

SIZE, SKIN = (160, 160), (205.0, 145.0, 130.0)
NECK = slice(50, 110)  # columns of the neck


@cache
def _head() -> HeadShape:
    return head_shape(drawn_face((80, 40), 60, "tan", SIZE).landmarks)


def _found(color: tuple[float, float, float], columns: slice, rows: slice | None) -> np.ndarray:
    """What is a collar where some cells of a neck, without rows those below the chin, have another colour."""
    rgb = np.full((*SIZE, 3), (40, 60, 90), np.float32)
    rgb[:, NECK] = SKIN
    rgb[rows or _below(), columns] = color
    probability = np.zeros(SIZE, np.float32)
    probability[:, NECK] = 0.95
    return collar(np.asarray(cv2.GaussianBlur(rgb, (0, 0), 0.5).round(), np.uint8), probability, _head())


def _below() -> slice:
    start = round(float(_head().chin[1])) + 12
    return slice(start, start + 30)


WHITE, GLEAM = (245.0, 222.0, 215.0), (245.0, 173.0, 155.0)


def test_a_white_strip_along_a_neck_is_a_collar() -> None:
    edge = slice(NECK.start, NECK.start + 3)
    found = _found(WHITE, edge, _below())
    assert found[_below(), edge].mean() > 0.6
    found[_below(), edge] = 0
    assert found.mean() < 0.005


@pytest.mark.parametrize(
    ("color", "columns", "rows"),
    [
        (WHITE, slice(72, 84), None),  # a gleam in the middle of the neck
        (GLEAM, slice(NECK.start, NECK.start + 3), None),  # of the skin's own colour
        ((140.0, 110.0, 105.0), slice(NECK.start, NECK.start + 3), None),  # paler, and darker: a beard's or shade
        (WHITE, slice(NECK.start, NECK.start + 3), slice(10, 40)),  # on a temple
    ],
    ids=["in the middle", "of the skin's colour", "darker", "above the chin"],
)
def test_skin_is_no_collar(color: tuple[float, float, float], columns: slice, rows: slice | None) -> None:
    assert _found(color, columns, rows).max() < 0.05


def test_without_skin_nothing_is_found() -> None:
    nothing = np.zeros(SIZE, np.float32)
    assert not collar(np.full((*SIZE, 3), 128, np.uint8), nothing, _head()).any()
