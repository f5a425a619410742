from __future__ import annotations

import pytest

from service.api.preferences import preferred_wait_s


@pytest.mark.parametrize(
    ("lines", "seconds"),
    [
        (["wait=5"], 5),
        (["respond-async, WAIT = 5; x=1"], 5),
        (['return=minimal, wait="7"', "wait=3"], 7),
        (["wait=100"], 60),
        (["wait=0"], 0),
        (["wait", "wait=-1", "wait=1.5", "waits=3"], None),
        ([], None),
    ],
)
def test_the_first_wait_of_prefer_counts(lines: list[str], seconds: int | None) -> None:
    assert preferred_wait_s(lines, most_s=60) == seconds
