from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.alone import run_alone
from benchmarks.clips import Window, make_clip
from benchmarks.growth import linear_fit, paper_costs
from benchmarks.membrane import direct_membrane, held_pixels
from benchmarks.targets import Target, asset_budget, target_rows
from benchmarks.timing import Measured, in_turns
from pvg.membrane.lattice import Lattice, build_membrane, rasterize_curves
from pvg.video import probe, read_frames


def test_the_direct_solve_reproduces_linear_fields_and_agrees_with_the_membrane() -> None:
    turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    points = np.stack([60 + 50 * np.cos(turn), 50 + 40 * np.sin(turn)], axis=1)
    values = np.stack([points[:, 0] - points[:, 1], 20 * np.sin(3 * turn)], axis=1)
    spans = ((0, len(points), True),)
    held, known = held_pixels(points, spans, values, (121, 101))
    y, x = np.mgrid[:101, :121]
    inside = np.hypot((x - 60) / 50, (y - 50) / 40) < 1.0
    assert inside.sum() > 5000
    solved = direct_membrane(held, known, inside | known)
    # held pixels carry the value of the curve up to 0.7 px away, and the slope is one level a pixel
    assert np.abs(solved[..., 0] - (x - y))[inside].max() < 1.5
    raster = rasterize_curves(points, spans, Lattice.over((0, 0, 121, 101)))
    ours = build_membrane(raster).solve(values).crop(0, 0, 121, 101)
    assert np.abs(ours - solved)[inside].mean() < 0.15


def test_things_are_measured_in_turns_forwards_and_backwards() -> None:
    order: list[str] = []
    taken = in_turns({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 3)
    assert order == ["a", "b", "b", "a", "a", "b"]
    assert len(taken["a"].wall.values) == len(taken["b"].cpu.values) == 3


def test_ratios_are_taken_round_by_round() -> None:
    ratio = Measured((2.0, 8.0, 3.0)).over(Measured((1.0, 2.0, 3.0)))
    assert ratio.values == (2.0, 4.0, 1.0)
    assert ratio.median == 2.0
    assert ratio.spread == 1.5


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


def test_a_target_is_met_at_its_bound_and_missed_beyond_it() -> None:
    assert Target("time", 3.0, 3.0, 3.0, "ms", 3.0).met
    assert not Target("time", 3.1, 3.1, 3.1, "ms", 3.0).met
    assert Target("gain", 100.0, 100.0, 100.0, "x", 100.0, at_most=False).met
    assert not Target("gain", 99.0, 99.0, 99.0, "x", 100.0, at_most=False).met
    assert Target("shown", 1.0, 1.0, 1.0, "s", None).met is None


def test_the_asset_budget_is_the_larger_of_its_two_parts() -> None:
    assert asset_budget(600_000, 100, 1920 * 1080) == 20_000
    assert asset_budget(60_000_000, 100, 1920 * 1080) == 90_000
    assert asset_budget(0, 100, 960 * 540) == 5_000


def test_only_rows_of_what_was_measured_are_shown() -> None:
    asset = {"bytes": 300_000, "source_bytes": 600_000, "frames": 100, "pixels": 1920 * 1080}
    (row,) = target_rows({"asset": asset})
    assert (row.value, row.target, row.met) == (3.0, 20.0, True)
    assert target_rows({}) == []


def test_a_clip_is_played_there_and_back_through_a_window(short_clip: Path, tmp_path: Path) -> None:
    info = probe(short_clip)
    window = Window(info.width / 2, info.height / 2, 480, 400, 0.5)
    made = make_clip(short_clip, tmp_path / "made.mp4", 90, window)
    assert (probe(made).width, probe(made).height) == (480, 400)
    frames = [frame.planes[0].astype(np.float32) for frame in read_frames(made)]
    assert len(frames) == 90
    middle = (slice(120, 280), slice(120, 360))  # the picture itself, half as large, without the repeated edge

    def apart(a: int, b: int) -> float:
        return float(np.abs(frames[a][middle] - frames[b][middle]).mean())

    assert apart(0, 39) > 2.0  # the clip moves
    assert max(apart(k, 79 - k) for k in range(0, 40, 8)) < 0.5 * apart(0, 39)  # frames 40 to 79 go back
    assert max(apart(k, 80 + k) for k in range(0, 10, 3)) < 0.5 * apart(0, 39)
    source = next(read_frames(short_clip))
    whole = source.planes[0][::2, ::2].astype(np.float32)
    rows = slice(120 - (400 - whole.shape[0]) // 2, 280 - (400 - whole.shape[0]) // 2)
    columns = slice(120 - (480 - whole.shape[1]) // 2, 360 - (480 - whole.shape[1]) // 2)
    assert np.abs(frames[0][middle] - whole[rows, columns]).mean() < 4.0


def test_work_in_a_process_of_its_own_tells_its_result_time_and_memory() -> None:
    alone = run_alone(asset_budget, 60_000_000, 100, 1, one_thread=True)
    assert alone.result == 90_000
    assert 0.0 <= alone.cpu_s <= 5.0
    assert 10.0 < alone.peak_mb < 2000.0


def test_an_error_in_a_process_of_its_own_comes_out() -> None:
    with pytest.raises(Exception, match="non-zero exit status"):
        run_alone(asset_budget, 1, 0, 1)
