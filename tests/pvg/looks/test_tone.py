from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.looks import SkinMap
from pvg.looks.opponent import to_opponent
from pvg.looks.tone import CRISP, steeper, tone_curve
from tests.pvg.looks.skins import skin_like

seeds = st.integers(0, 1000)


@given(seeds, seeds)
def test_the_tone_curve_takes_the_median_to_the_median_and_black_to_black(one: int, two: int) -> None:
    source, target = (np.sort(to_opponent(skin_like(seed))[:, 0]) for seed in (one, two))
    curve = tone_curve(source, target)
    assert abs(curve[0]) < 1e-9
    assert abs(np.interp(np.median(source), np.arange(256), curve) - np.median(target)) < 1


@pytest.mark.parametrize(("source", "target"), [(0.0, 0.0), (0.0, 100.0), (100.0, 0.0)])
def test_of_skin_that_is_wholly_black_the_tone_curve_says_nothing(source: float, target: float) -> None:
    curve = tone_curve(np.full(50, source), np.full(50, target))
    np.testing.assert_array_equal(curve, np.arange(256.0))
    black, other = (np.full((50, 3), level, np.float32) for level in (source, target))
    assert np.isfinite(SkinMap.between(black, other.astype(np.float64))(black)).all()


@given(seeds, seeds)
def test_the_tone_curve_keeps_order(one: int, two: int) -> None:
    curve = tone_curve(*(to_opponent(skin_like(seed))[:, 0] for seed in (one, two)))
    assert (np.diff(curve) > 0).all()


def test_the_tone_curve_keeps_order_where_skin_that_is_nearly_black_gets_nearly_white() -> None:
    """It rose to 368 and fell again, by 0.6 levels a level."""
    source, target = np.geomspace(0.1, 100, 200), np.linspace(160, 250, 200)
    curve = tone_curve(source, target)
    assert np.diff(curve).min() >= 0
    assert curve.max() <= 255 + 1e-9


@given(seeds, seeds)
def test_a_curve_is_made_steeper_below_the_skins_middle_alone(one: int, two: int) -> None:
    source, target = (to_opponent(skin_like(seed))[:, 0] for seed in (one, two))
    plain, levels, middle = tone_curve(source, target), np.arange(256), float(np.median(source))
    steep = steeper(plain, middle, CRISP)
    more, gain = steep - plain, np.interp(middle, levels, plain) / middle
    np.testing.assert_allclose(more[levels > 1.1 * middle + 2], 0, atol=0.5)
    assert (more[levels < 0.9 * middle - 2] <= 0.5).all()
    # nor darker than by the gain of the skin's middle: black stays black
    assert (steep >= np.minimum(plain, gain * levels) - 1e-9).all()
    assert np.diff(steep).min() >= -1e-9


@pytest.mark.parametrize(("start", "stop"), [(190, 110), (110, 190), (90, 225)])
def test_shading_is_neither_enlarged_to_soot_nor_flattened_to_a_mask(start: int, stop: int) -> None:
    """T' stays within bounds of T/Y, the slope of the same face in more or less light, where there is room."""
    rng = np.random.default_rng(start)
    for own, wanted in ((15, 40), (25, 3)):  # flat and shaded faces by shaded and flat references
        source, target = rng.normal(start, own, 600), rng.normal(stop, wanted, 600)
        table = tone_curve(np.clip(source, 1, 254), np.clip(target, 1, 254))
        levels = np.arange(256.0)
        seen = (levels > np.quantile(source, 0.05)) & (levels < np.quantile(source, 0.8))
        gains = (np.gradient(table) * levels / np.maximum(table, 1))[seen]
        assert gains.max() < 1.5  # 1.2 between quantiles, a little more where corners are rounded
        if wanted < own:
            assert gains[: len(gains) // 2].min() > 0.35
