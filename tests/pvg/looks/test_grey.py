from __future__ import annotations

import numpy as np
import pytest

from pvg._arrays import smoothstep
from pvg.looks.grey import told_from_grey

LUMAS = np.linspace(0.0, 2.0, 401)


@pytest.mark.parametrize("beard", [0.0, 1.0])
def test_skin_in_usual_light_is_told_alike_at_all_lumas_but_those_of_glare(beard: float) -> None:
    grey, skin = told_from_grey(0.75, LUMAS[LUMAS <= 1.15], beard)
    np.testing.assert_allclose(grey, 0.2)
    np.testing.assert_allclose(skin, 0.6)


def test_shade_of_another_hue_is_skin_however_grey_and_what_is_darker_or_brighter_is_not() -> None:
    grey, skin = told_from_grey(0.5, np.array([0.4, 0.9, 1.5]), 0.0)
    np.testing.assert_allclose(grey, (0.2, -0.6, 0.12))
    np.testing.assert_allclose(skin, (0.6, 0.0, 1.0))


@pytest.mark.parametrize("alike", [0.3, 0.75])
def test_glare_takes_about_the_share_of_skin_that_it_is_mixed_with(alike: float) -> None:
    (grey,), (skin,) = told_from_grey(alike, np.array([1.6]), 0.0)
    mixed = np.linspace(0.0, 1.0, 21)
    taken = smoothstep(mixed, float(grey), float(skin))
    assert np.abs(taken - mixed).max() < 0.2
    assert taken[mixed <= 0.1].max() == 0  # white hair, collars


@pytest.mark.parametrize("beard", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("alike", np.linspace(-0.3, 1.0, 14))
def test_both_ends_lie_apart_and_change_without_a_step(alike: float, beard: float) -> None:
    told = told_from_grey(float(alike), LUMAS, beard)
    assert (told[1] - told[0]).min() > 0.01
    assert np.abs(np.diff(told)).max() < 0.03


def test_less_is_told_to_be_grey_the_less_a_part_of_the_skin_is_like_the_rest() -> None:
    told = np.array([told_from_grey(alike, np.array([0.9]), 0.0) for alike in np.linspace(1.0, -0.3, 131)])
    assert np.diff(told, axis=0).max() <= 1e-12
    assert np.abs(np.diff(told, axis=0)).max() < 0.05
