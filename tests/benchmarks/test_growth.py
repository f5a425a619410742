from __future__ import annotations

import pytest

from benchmarks.growth import linear_fit, paper_costs


def test_a_line_is_fitted_with_its_slopes() -> None:
    fit = linear_fit([1, 2, 4, 8], [3, 6, 12, 24])
    assert fit["slope"] == pytest.approx(3.0)
    assert fit["intercept"] == pytest.approx(0.0, abs=1e-9)
    assert fit["r2"] == pytest.approx(1.0)
    assert fit["log_slope"] == pytest.approx(1.0)


def test_the_costs_of_the_three_ways_follow_the_formulas() -> None:
    symbols = ("T_OMT", "T_V", "T_V-OMT", "T_follow", "T_match", "T_R", "T_decode", "T_encode")
    times = {name: 1000.0 * 10.0**k for k, name in enumerate(symbols)}
    costs = paper_costs(times, n=3, m=2)
    assert costs["raster transport"] == pytest.approx(6)
    assert costs["per-frame vectorisation"] == pytest.approx(3 * 10 + 6 * 100 + 6 * 1e5)
    assert costs["ours"] == pytest.approx(10 + 2 * 1e3 + 2 * 100 + 6 * (1e4 + 1e5))
    assert costs["decoding and encoding"] == pytest.approx(3 * 1e6 + 6 * 1e7)
