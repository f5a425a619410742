from __future__ import annotations

import numpy as np
import pytest

from benchmarks.quality.carried import Described, carried_row, light_correlation, share_carried, slope_and_correlation
from benchmarks.quality.measures import less_running_mean
from benchmarks.quality.ramp import GAINS, ramp_frames


def described(skin: tuple[float, ...], lips: tuple[float, ...], light: tuple[float, ...] = (0, 0)) -> Described:
    middle = np.array(skin, float)
    return Described(middle, middle, {"lips": np.array(lips, float)}, 20.0, 5.0, np.array(light, float))


def test_lips_that_go_halfway_carry_half_of_the_gap() -> None:
    before, wanted = described((60, 10, 15), (-10, 10, 0)), described((40, 10, 15), (-10, 20, 0))
    halfway = described((40, 10, 15), (-10, 15, 0))
    assert share_carried([carried_row(before, halfway, wanted)["lips"]]) == pytest.approx(50)
    assert share_carried([carried_row(before, before, wanted)["lips"]]) == 0


def test_skin_around_the_lips_that_moves_as_the_face_does_not_leak() -> None:
    before, after = described((60, 10, 15), (0, 0, 0)), described((40, 10, 15), (0, 0, 0))
    row = carried_row(before, after, after)
    assert row["leak"] == pytest.approx(1)
    assert row["cloud"] == pytest.approx(0, abs=1e-6)
    assert "leak" not in carried_row(before, before, after)


def test_tones_that_follow_the_reference_have_slope_one() -> None:
    triples = [[10.0, 2 * wanted, wanted] for wanted in (5.0, 10.0, 30.0)]
    assert slope_and_correlation(triples) == pytest.approx((1, 1))
    slope, _ = slope_and_correlation([[10.0, wanted**0.5, wanted] for wanted in (5.0, 10.0, 30.0)])
    assert slope == pytest.approx(0.5)


def test_the_place_of_light_is_the_mean_of_two_correlations() -> None:
    rows = [[[0.0, 0.0], [x, -y], [x, y]] for x, y in ((1.0, 2.0), (3.0, -1.0), (-2.0, 0.5))]
    assert light_correlation(rows) == pytest.approx(0)  # left and right follow, up and down oppose


def test_less_its_running_mean_a_slope_is_flat_and_a_cut_no_step() -> None:
    slope = np.linspace(30, 40, 100)
    assert np.abs(less_running_mean(list(slope), [False] * 100, 25))[12:-12].max() < 1e-5
    cut = [30.0] * 50 + [40.0] * 50
    breaks = [i == 50 for i in range(100)]
    assert np.abs(less_running_mean(cut, breaks, 25)).max() == 0
    assert np.abs(less_running_mean(cut, [False] * 100, 25)).max() > 4


def test_flicker_stays_when_the_running_mean_is_taken() -> None:
    flicker = np.random.default_rng(0).normal(35, 0.1, 400)
    assert np.std(less_running_mean(list(flicker), [False] * 400, 25)) == pytest.approx(0.1, rel=0.1)


def test_the_ramp_down_is_the_ramp_up_backwards() -> None:
    picture = np.full((4, 6, 3), 200, np.uint8)
    up, down = (list(ramp_frames(picture, up=way)) for way in (True, False))
    assert [frame.mean() for frame in up] == [frame.mean() for frame in down][::-1]
    assert up[0].mean() == 200 * GAINS[0]
    assert up[-1].mean() == 200 * GAINS[1]
