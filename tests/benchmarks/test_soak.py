from __future__ import annotations

import numpy as np
import pytest

from benchmarks.soak import fitted, report, soak

HOUR = np.linspace(0.0, 3600.0, 400)


def test_a_line_has_its_slope_and_noise_has_none() -> None:
    noise = np.random.default_rng(1).normal(0, 20, HOUR.size)
    leak = fitted("memory", "MB", HOUR, 100 + HOUR / 3600 * 60 + noise)
    assert leak.per_hour == pytest.approx(60, abs=4 * leak.error)
    assert leak.verdict == "GROWS"
    assert fitted("memory", "MB", HOUR, 100 + noise).verdict == "steady"


def test_a_short_run_accuses_nothing_that_gained_little() -> None:
    minutes = HOUR / 30
    assert fitted("disk", "disk MB", minutes, 1 + minutes / 120 * 2).verdict == "too short to tell"
    assert fitted("disk", "disk MB", minutes, 1 + minutes / 120 * 9).verdict == "GROWS"


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="too few"):
        fitted("memory", "MB", HOUR[:10], HOUR[:10])


@pytest.mark.slow
def test_a_soak_of_20_s() -> None:
    slopes, work = soak(20, 2, interval_s=0.25)
    assert {one.name for one in slopes} >= {
        "memory of API",
        "memory of worker",
        "memory of children",
        "threads",
        "disk: records",
        "disk: media",
    }
    assert all(one.first > 0 for one in slopes if one.unit not in ("jobs", "disk MB"))
    assert work.done["succeeded"] > 0
    assert not work.wrong
    assert len(list(report(slopes, work))) >= len(slopes) + 2
