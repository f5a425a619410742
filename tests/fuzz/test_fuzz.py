"""A few seconds of fuzzing, the same cases each time; `make fuzz` goes on for longer with others."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.fuzz.__main__ import fuzzed
from tests.fuzz.finds import FINDS, Find
from tests.fuzz.targets import MAKERS, seeded


@pytest.mark.parametrize(("name", "cases"), [("media", 1000), ("asset", 80)])
def test_changed_files_are_answered_by_an_error_of_ours(name: str, cases: int, tmp_path: Path) -> None:
    """In a process of its own, for decoders may crash."""
    assert fuzzed(name, 1, math.inf, tmp_path, cases=cases) == 0


@pytest.mark.parametrize(("name", "cases"), [("forms", 300), ("ranges", 5000)])
def test_changed_requests_are_answered_by_an_error_of_ours(name: str, cases: int, tmp_path: Path) -> None:
    target = MAKERS[name](tmp_path)
    for number in range(cases):
        try:
            target.do(seeded(target, 1, number))
        except target.expected:
            continue


@pytest.mark.parametrize("find", FINDS, ids=lambda find: find.what)
def test_what_was_found_before_is_answered(find: Find) -> None:
    with pytest.raises(find.expected):
        find.do(find.data)
