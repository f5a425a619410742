"""Writers of one SQLite file take turns in the order in which they came."""

from __future__ import annotations

import threading
import time

import pytest

from service.catalog.database import _Line
from tests.side_by_side import at_once
from tests.waiting import until


def _join(line: _Line, name: int, served: list[int]) -> threading.Thread:
    """A thread that stands in line, is served, and hands over."""

    def work() -> None:
        assert line.acquire(30.0)
        served.append(name)
        line.release()

    before = len(line._waiting)
    thread = threading.Thread(target=work)
    thread.start()
    until(lambda: len(line._waiting) == before + 1)
    return thread


@pytest.fixture
def taken() -> _Line:
    """One that somebody has."""
    line = _Line()
    assert line.acquire(1.0)
    return line


def test_who_came_first_is_served_first(taken: _Line) -> None:
    served: list[int] = []
    threads = [_join(taken, name, served) for name in range(8)]
    taken.release()
    for thread in threads:
        thread.join(30)
    assert served == list(range(8))


def test_who_gives_up_leaves_the_line(taken: _Line) -> None:
    served: list[int] = []
    assert not taken.acquire(0.01)
    thread = _join(taken, 1, served)
    taken.release()
    thread.join(30)
    assert served == [1]
    assert taken.acquire(0.0)


@pytest.mark.parametrize("threads", [2, 6])
def test_one_at_a_time(threads: int) -> None:
    line, inside, seen = _Line(), list[int](), list[int]()

    def work() -> None:
        for _ in range(200):
            if line.acquire(0.0005):
                inside.append(1)
                time.sleep(0)  # others come meanwhile
                seen.append(len(inside))
                inside.pop()
                line.release()

    at_once([work] * threads)
    assert set(seen) == {1}
    assert line.acquire(1.0)  # nobody has kept it
