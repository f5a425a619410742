from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pvg.looks import SkinMap
from pvg.looks.tone import _CONTRAST_RANGE, _SLOPES, to_opponent, to_rgb, tone_curve

seeds = st.integers(0, 1000)


def skin_like(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.uniform(60, 200, 3) + rng.normal(0, rng.uniform(4, 20), (300, 3))).clip(0, 255).astype(np.float32)


def any_colors(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (50, 3)).astype(np.float32)


@given(seeds)
def test_luma_and_chroma_lead_back_to_the_colour(seed: int) -> None:
    np.testing.assert_allclose(to_rgb(to_opponent(any_colors(seed))), any_colors(seed), atol=1e-3)


@given(seeds)
def test_the_map_to_itself_is_the_identity_with_a_contrast_of_one(seed: int) -> None:
    skin = skin_like(seed)
    same = SkinMap.between(skin, skin.astype(float))
    np.testing.assert_allclose(same(any_colors(seed + 1)), any_colors(seed + 1), atol=1e-3)
    np.testing.assert_allclose(same.contrast(any_colors(seed + 1)), 1, atol=1e-3)


@given(seeds, seeds)
def test_the_tone_curve_takes_the_median_to_the_median_and_black_to_black(one: int, two: int) -> None:
    source, target = (np.sort(to_opponent(skin_like(seed))[:, 0]) for seed in (one, two))
    curve = tone_curve(source, target)
    assert abs(curve[0]) < 1e-9
    assert abs(np.interp(np.median(source), np.arange(256), curve) - np.median(target)) < 3  # its corners are rounded


@given(seeds, seeds)
def test_the_tone_curve_keeps_order_and_its_bounds_between_the_quantiles(one: int, two: int) -> None:
    source, target = (to_opponent(skin_like(seed))[:, 0] for seed in (one, two))
    curve = tone_curve(source, target)
    assert (np.diff(curve) > 0).all()
    low, high = (int(v) for v in np.quantile(source, (0.1, 0.9)))
    slopes = np.diff(curve)[low + 4 : high - 4]  # without what the smoothing brings in from beyond
    assert (slopes >= _SLOPES[0] - 1e-6).all()
    assert (slopes <= _SLOPES[1] + 1e-6).all()


@given(seeds, seeds)
def test_black_stays_black(one: int, two: int) -> None:
    """A brow or a lash takes no chroma from the reference's skin."""
    change = SkinMap.between(skin_like(one), skin_like(two).astype(float))
    np.testing.assert_allclose(change(np.zeros((1, 3), np.float32)), 0, atol=1e-6)


@given(seeds, seeds)
def test_the_contrast_stays_in_its_range(one: int, two: int) -> None:
    contrast = SkinMap.between(skin_like(one), skin_like(two).astype(float)).contrast(any_colors(one))
    assert contrast[:, 0].min() >= _CONTRAST_RANGE[0]
    assert contrast[:, 0].max() <= _CONTRAST_RANGE[1]
