"""Writers of one SQLite file take turns in the order in which they came."""

from __future__ import annotations

import threading

import pytest

from service.catalog.database import _Line
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


def test_who_came_first_is_served_first() -> None:
    line, served = _Line(), list[int]()
    assert line.acquire(1.0)
    threads = [_join(line, name, served) for name in range(8)]
    line.release()
    for thread in threads:
        thread.join(30)
    assert served == list(range(8))


def test_who_gives_up_leaves_the_line() -> None:
    line, served = _Line(), list[int]()
    assert line.acquire(1.0)
    assert not line.acquire(0.01)
    thread = _join(line, 1, served)
    line.release()
    thread.join(30)
    assert served == [1]
    assert line.acquire(0.0)


@pytest.mark.parametrize("threads", [2, 6])
def test_one_at_a_time(threads: int) -> None:
    line, inside, most = _Line(), [0], [0]

    def work() -> None:
        for _ in range(200):
            if line.acquire(0.0005):
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                inside[0] -= 1
                line.release()

    workers = [threading.Thread(target=work) for _ in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert most[0] == 1
    assert line.acquire(1.0)  # nobody has kept it
