from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pvg.looks import sliced_transport, sliced_wasserstein


def cloud(seed: int, n: int, mean: tuple[float, float, float], spread: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    mix = np.eye(3) + 0.5 * rng.standard_normal((3, 3))
    return np.asarray(mean) + spread * rng.standard_normal((n, 3)) @ mix


SKIN = cloud(1, 700, (150.0, 110.0, 95.0), 12.0)
LOOK = cloud(2, 700, (205.0, 170.0, 150.0), 20.0)


def transport(a: np.ndarray, b: np.ndarray, seed: int = 0, **options: object) -> np.ndarray:
    return sliced_transport(a, b, rng=np.random.default_rng(seed), **options)  # type: ignore[arg-type]


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return sliced_wasserstein(a, b, rng=np.random.default_rng(99), projections=200)


few_colors = arrays(np.float64, st.tuples(st.integers(1, 25), st.just(3)), elements=st.integers(0, 4).map(float))


@given(few_colors, st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_the_same_set_is_a_fixed_point(colors: np.ndarray, seed: int) -> None:
    shuffled = np.random.default_rng(seed).permutation(colors)
    assert np.abs(transport(colors, shuffled, seed) - colors).max() < 1e-9


@pytest.mark.parametrize("iterations", [0, 1, 5, 20])
def test_transport_moves_the_mean_by_one_minus_beta_to_the_n(iterations: int) -> None:
    gap = np.abs(LOOK.mean(0) - transport(SKIN, LOOK, iterations=iterations).mean(0))
    np.testing.assert_allclose(gap, 0.8**iterations * np.abs(LOOK.mean(0) - SKIN.mean(0)), atol=1e-9)


def test_the_mean_still_closes_when_the_sets_differ_in_size() -> None:
    fewer = LOOK[:311]
    gap = np.abs(fewer.mean(0) - transport(SKIN, fewer).mean(0)).max()
    assert gap < 0.0115 * np.abs(fewer.mean(0) - SKIN.mean(0)).max() + 0.15


@given(few_colors, few_colors, st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_transport_commutes_with_permutations_bit_for_bit(a: np.ndarray, b: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(a))
    np.testing.assert_array_equal(transport(a[order], rng.permutation(b), 3), transport(a, b, 3)[order])


@pytest.mark.parametrize("n", [7, 64, 1001])
def test_equal_colors_go_to_equal_colors_bit_for_bit(n: int) -> None:
    rng = np.random.default_rng(n)
    distinct = rng.uniform(0.0, 255.0, (max(2, n // 5), 3))
    index = rng.integers(0, len(distinct), n)
    moved = transport(distinct[index], LOOK)
    for i in np.unique(index):
        copies = moved[index == i]
        assert (copies == copies[0]).all()
    assert len(np.unique(moved, axis=0)) == len(np.unique(index))


def test_shifting_the_reference_leaves_the_shape_of_the_result() -> None:
    shift = np.array([13.0, -7.0, 4.5])
    moved, shifted = transport(SKIN, LOOK), transport(SKIN + shift, LOOK + shift)
    np.testing.assert_allclose(shifted, moved + shift, atol=1e-8)


def test_a_seed_fixes_the_result_and_another_changes_it() -> None:
    np.testing.assert_array_equal(transport(SKIN, LOOK, 5), transport(SKIN, LOOK, 5))
    assert not np.array_equal(transport(SKIN, LOOK, 5), transport(SKIN, LOOK, 6))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_twenty_iterations_bring_gaussian_clouds_95_percent_closer(seed: int) -> None:
    a, b = cloud(seed, 2000, (120.0, 90.0, 75.0), 10.0), cloud(seed + 50, 1500, (200.0, 170.0, 160.0), 18.0)
    assert distance(transport(a, b, seed), b) < 0.05 * distance(a, b)


def test_more_iterations_give_the_covariance_of_the_reference() -> None:
    moved = transport(SKIN, LOOK, iterations=60)
    np.testing.assert_allclose(np.cov(moved.T), np.cov(LOOK.T), rtol=0.1, atol=15.0)


def test_a_single_color_goes_to_the_medians_and_a_single_reference_pulls_all() -> None:
    alone = transport(SKIN[:1], LOOK)
    assert np.abs(alone - np.median(LOOK, axis=0)).max() < 0.0116 * np.abs(SKIN[0] - LOOK.mean(0)).max() + 3.0
    pulled = transport(SKIN, LOOK[:1])
    np.testing.assert_allclose(pulled - LOOK[0], 0.8**20 * (SKIN - LOOK[0]), atol=1e-9)


def test_integer_weights_equal_repeated_colors() -> None:
    rng = np.random.default_rng(8)
    a, b = SKIN[:60], LOOK[:45]
    times_a = rng.integers(1, 4, len(a))
    weighted = transport(a, b, weights=times_a)
    repeated = transport(np.repeat(a, times_a, axis=0), b)
    np.testing.assert_allclose(weighted, repeated[np.cumsum(times_a) - 1], atol=1e-9)
    np.testing.assert_allclose(transport(a, b, weights=7.0 * times_a), weighted, atol=1e-9)


def test_the_distance_of_shifted_copies_is_the_shift_over_root_three() -> None:
    shift = np.array([30.0, 0.0, 0.0])
    measured = sliced_wasserstein(SKIN, SKIN + shift, rng=np.random.default_rng(0), projections=4000)
    assert measured == pytest.approx(30.0 / np.sqrt(3.0), rel=0.03)
    assert distance(SKIN, np.random.default_rng(1).permutation(SKIN)) < 1e-6
    assert distance(SKIN, LOOK) == pytest.approx(distance(LOOK, SKIN), rel=1e-12)
    assert distance(np.repeat(SKIN, 3, axis=0), SKIN) < 1e-6


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.empty((0, 3)), LOOK),
        (SKIN, np.empty((0, 3))),
        (np.full((4, 3), np.nan), LOOK),
        (SKIN, np.full((4, 3), np.inf)),
        (SKIN[:, :2], LOOK),
    ],
)
def test_empty_misshapen_and_non_finite_colors_are_refused(a: np.ndarray, b: np.ndarray) -> None:
    with pytest.raises(ValueError, match="must"):
        transport(a, b)
    with pytest.raises(ValueError, match="must"):
        distance(a, b)


@pytest.mark.parametrize(
    "options",
    [
        {"beta": 0.0},
        {"beta": 1.5},
        {"iterations": -1},
        {"weights": np.ones(3)},
        {"weights": np.zeros(len(SKIN))},
    ],
)
def test_parameters_out_of_range_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="must"):
        transport(SKIN, LOOK, **options)
