"""A minute of cases made from the schema, the same each time; `make fuzz` goes on for longer with others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.contract.fuzzing import hunt
from tests.promises import Drill


@pytest.mark.timeout(600)
def test_no_request_is_answered_otherwise_than_the_schema_says(promise: Callable[..., Drill], tmp_path: Path) -> None:
    drill = promise("R19", wanted="no 5xx, every answer documented, in 40 s of cases")
    found = hunt(tmp_path, seed=1, examples=5, seconds=40)
    drill.measured = f"{found.cases} cases, {'something' if found.found else 'nothing'} found"
    assert not found.found, found.said
    assert found.cases >= 20, found.said
