from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from service.catalog import Progress
from worker.progress import ProgressScale

CALLS = st.lists(st.tuples(st.sampled_from(["landmarks", "skin", "other"]), st.integers(0, 50), st.integers(0, 40)))


@given(CALLS)
def test_the_fraction_never_falls_and_stays_in_range(calls: list[tuple[str, int, int]]) -> None:
    seen: list[Progress] = []
    scale = ProgressScale(seen.append)
    scale.expect({"landmarks": (0.0, 0.5), "skin": (0.5, 0.9)})
    for stage, done, total in calls:
        scale(stage, done, total)
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert all(0 <= fraction <= 0.9 for fraction in fractions)
    assert all(progress.frames_done <= progress.frames_total for progress in seen)


def test_stages_fill_their_spans() -> None:
    seen: list[Progress] = []
    scale = ProgressScale(seen.append)
    scale.expect({"landmarks": (0.0, 0.5), "skin": (0.5, 0.9)})
    for call in (("landmarks", 5, 10), ("landmarks", 10, 10), ("skin", 1, 4), ("skin", 4, 4)):
        scale(*call)
    assert [progress.fraction for progress in seen] == [0.25, 0.5, 0.6, 0.9]
    assert seen[2] == Progress("skin", 0.6, 1, 4)
