from __future__ import annotations

import pytest

from benchmarks.alone import run_alone
from benchmarks.targets import asset_budget


def test_work_in_a_process_of_its_own_tells_its_result_time_and_memory() -> None:
    alone = run_alone(asset_budget, 60_000_000, 100, 1, one_thread=True)
    assert alone.result == 90_000
    assert 0.0 <= alone.cpu_s <= 5.0
    assert 10.0 < alone.peak_mb < 2000.0


def test_an_error_in_a_process_of_its_own_comes_out() -> None:
    with pytest.raises(Exception, match="non-zero exit status"):
        run_alone(asset_budget, 1, 0, 1)
