from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pvg.looks import ComplexionMap
from pvg.looks.tone import _GAIN_RANGE

seeds = st.integers(0, 1000)


def skin_like(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.uniform(60, 200, 3) + rng.normal(0, rng.uniform(4, 20), (300, 3))).clip(0, 255).astype(np.float32)


@given(seeds)
def test_the_map_to_itself_is_the_identity(seed: int) -> None:
    skin = skin_like(seed)
    colors = np.random.default_rng(seed + 1).uniform(0, 255, (50, 3)).astype(np.float32)
    np.testing.assert_allclose(ComplexionMap.between(skin, skin.astype(float))(colors), colors, atol=1e-3)


@given(seeds, seeds)
def test_the_median_skin_arrives_at_the_median_of_the_other(one: int, two: int) -> None:
    skin, other = skin_like(one), skin_like(two).astype(float)
    mapped = ComplexionMap.between(skin, other)(np.median(skin, axis=0)[None])
    np.testing.assert_allclose(mapped[0], np.median(other, axis=0), atol=1e-3)


@given(seeds, seeds)
def test_differences_grow_by_no_more_than_the_bounded_gain(one: int, two: int) -> None:
    skin, other = skin_like(one), skin_like(two).astype(float)
    change = ComplexionMap.between(skin, other)
    near = np.median(skin, axis=0) + np.random.default_rng(one).normal(0, 1.0, (20, 3))
    steps = change(near.astype(np.float32)) - change.end
    bound = 1.01 * _GAIN_RANGE[1] * np.abs(near - change.start) * change.ratio + 1e-3
    assert (np.abs(steps) <= bound).all()
