from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import cv2
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from pvg import _threads
from pvg._threads import DEPTH, Sink, ahead, one_blas_thread, one_opencv_thread
from tests.threads import own_threads
from tests.waiting import until


@pytest.fixture
def alive() -> Callable[[], list[str]]:
    """What names the library's threads of this test that are there."""
    return own_threads("pvg-")


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_blas_has_one_thread_from_the_first_block_to_the_last_and_its_own_after_it() -> None:
    with threadpool_limits(limits=2, user_api="blas"):
        one, other = one_blas_thread(), one_blas_thread()
        one.__enter__()
        other.__enter__()
        one.__exit__(None, None, None)
        assert blas_threads() == {1}
        other.__exit__(None, None, None)
        assert blas_threads() == {2}


def test_blas_that_was_loaded_since_is_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []

    class Controller(_threads.ThreadpoolController):
        def __init__(self) -> None:
            super().__init__()
            found.append(self)

    monkeypatch.setattr(_threads, "ThreadpoolController", Controller)
    for blocks in (1, 2):
        with one_blas_thread(), one_blas_thread():
            assert len(found) == blocks


def test_opencv_has_one_thread_from_the_first_block_to_the_last_and_its_own_after_it() -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        one, other = one_opencv_thread(), one_opencv_thread()
        one.__enter__()
        other.__enter__()
        one.__exit__(None, None, None)
        assert cv2.getNumThreads() == 1
        other.__exit__(None, None, None)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


def test_items_made_ahead_come_whole_and_in_order(alive: Callable[[], list[str]]) -> None:
    assert list(ahead(iter(range(100)), depth=3)) == list(range(100))
    assert alive() == []


def test_an_error_comes_after_the_items_made_before_it(alive: Callable[[], list[str]]) -> None:
    def broken() -> Iterator[int]:
        yield 1
        yield 2
        raise OSError("disk")

    items = ahead(broken())
    seen = [next(items), next(items)]
    with pytest.raises(OSError, match="disk"):
        next(items)
    assert seen == [1, 2]
    assert alive() == []


def test_leaving_early_ends_the_thread_and_closes_the_source(alive: Callable[[], list[str]]) -> None:
    closed = threading.Event()

    def endless() -> Iterator[int]:
        try:
            k = 0
            while True:
                yield k
                k += 1
        finally:
            closed.set()

    items = ahead(endless())
    assert [next(items) for _ in range(3)] == [0, 1, 2]
    items.close()
    assert closed.is_set()
    assert alive() == []


def test_only_a_few_items_are_made_ahead() -> None:
    made: list[int] = []

    def counting() -> Iterator[int]:
        for k in range(1000):
            made.append(k)
            yield k

    items = ahead(counting(), depth=2)
    next(items)
    items.close()
    assert len(made) <= 1 + 2 + 2  # taken, in the queue, one waiting to be put, one after the queue was emptied


def test_a_sink_does_all_work_in_order_before_it_is_left(alive: Callable[[], list[str]]) -> None:
    done: list[int] = []
    with Sink(done.append) as sink:
        for k in range(5 * DEPTH):
            sink.put(k)
    assert done == list(range(5 * DEPTH))
    assert alive() == []


def test_a_failing_sink_raises_once_drops_the_rest_and_never_blocks(alive: Callable[[], list[str]]) -> None:
    done: list[int] = []

    def work(item: int) -> None:
        if item == 2:
            raise OSError("disk")
        done.append(item)

    def feed() -> None:
        with Sink(work) as sink:
            for k in range(10 * DEPTH):
                sink.put(k)

    with pytest.raises(OSError, match="disk"):
        feed()
    assert done == [0, 1]
    assert alive() == []


def test_an_error_outside_drops_what_still_waits(alive: Callable[[], list[str]]) -> None:
    go, done = threading.Event(), []

    def work(item: int) -> None:
        go.wait(60)
        done.append(item)

    def go_on_once_it_is_left(sink: Sink[int]) -> None:
        until(lambda: sink._error is not None)
        go.set()

    def feed() -> None:
        with Sink(work) as sink:
            for k in range(DEPTH):
                sink.put(k)
            threading.Thread(target=go_on_once_it_is_left, args=(sink,)).start()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        feed()
    assert len(done) <= 1
    assert alive() == []
