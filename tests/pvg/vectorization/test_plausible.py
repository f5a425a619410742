"""Faces whose colours are no skin's are said to be so."""

from __future__ import annotations

import numpy as np
import pytest

from pvg.vectorization.plausible import doubts


def skin(r: float, g: float, b: float) -> np.ndarray:
    spread = np.random.default_rng(2).normal(1, 0.05, (200, 1))
    return np.clip(np.array((r, g, b)) * spread, 0, 255).astype(np.float32)


@pytest.mark.parametrize(
    "color", [(220, 180, 160), (150, 100, 75), (70, 45, 35), (240, 205, 185), (190, 120, 70), (180, 175, 172)]
)
def test_skin_of_any_tone_and_of_a_grey_film_raises_none(color: tuple[float, float, float]) -> None:
    assert doubts(skin(*color)) == ()


@pytest.mark.parametrize("color", [(200, 20, 30), (120, 190, 220), (60, 90, 200), (60, 140, 60)])
def test_scarfs_masks_and_paint_raise_one(color: tuple[float, float, float]) -> None:
    (doubt,) = doubts(skin(*color))
    assert "a colour that skin has not" in doubt


def test_black_and_burnt_out_skin_raise_one() -> None:
    assert "nearly black" in doubts(skin(28, 22, 19))[0]
    assert "burnt out" in doubts(skin(270, 230, 215))[0]


def test_no_open_skin_raises_none() -> None:
    assert doubts(np.empty((0, 3), np.float32)) == ()
