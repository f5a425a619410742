from __future__ import annotations

from benchmarks.targets import Target, asset_budget, target_rows


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
