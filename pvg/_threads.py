"""Stages of a pipeline in threads of their own, with bounded queues between them.

Decoding, solving and encoding release the interpreter's lock, so a thread each keeps all cores busy. An error in a
thread comes out where its results are awaited, and leaving early ends the threads.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from queue import Empty, Queue
from threading import Event, Lock, Thread
from types import TracebackType
from typing import Generic, Self, TypeVar

import cv2
from threadpoolctl import ThreadpoolController

T = TypeVar("T")
First = TypeVar("First")
Second = TypeVar("Second")

DEPTH = 4


@contextmanager
def one_blas_thread() -> Generator[None, None, None]:
    """Keep NumPy's matrix products on the thread that asks for them, in the whole process while the block lasts.

    The pipeline's stages already take the cores; the products here are small, and the library's own threads spin
    between two of them. Blocks may overlap in any order: the first limits the libraries that are loaded then, the last
    one to be left gives them back what they had.
    """
    with _blas:
        yield


@contextmanager
def one_opencv_thread() -> Generator[None, None, None]:
    """The same for OpenCV, whose threads spin as well: where a pipeline has a thread for each of its stages.

    A picture by itself is done sooner with all of them.
    """
    with _opencv:
        yield


class _Limit(AbstractContextManager[None]):
    """A limit of the whole process, counted: blocks may overlap in any order."""

    def __init__(self, limit: Callable[[], AbstractContextManager[object]]) -> None:
        self._limit = limit
        self._lock = Lock()
        self._inside = 0
        self._limits = ExitStack()

    def __enter__(self) -> None:
        """One more block; the first one limits."""
        with self._lock:
            if self._inside == 0:
                self._limits.enter_context(self._limit())
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        """One block less; after the last one all is as it was."""
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._limits.close()


@contextmanager
def _opencv_limit() -> Generator[None, None, None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


_blas = _Limit(lambda: ThreadpoolController().limit(limits=1, user_api="blas"))
_opencv = _Limit(_opencv_limit)


def side_by_side(first: Callable[[], First], second: Callable[[], Second]) -> tuple[First, Second]:
    """The results of both, the first made in a thread of its own; it pays for what holds no lock of the interpreter."""
    with ThreadPoolExecutor(1) as other:
        started = other.submit(first)
        result = second()
        return started.result(), result


def ahead(items: Iterable[T], depth: int = DEPTH) -> Generator[T, None, None]:
    """The items, made in a thread that runs up to `depth` of them ahead. What making them raises is raised here."""
    queue: Queue[tuple[bool, T | BaseException | None]] = Queue(depth)
    left = Event()

    def fill() -> None:
        try:
            for item in items:
                queue.put((True, item))
                if left.is_set():
                    return
            queue.put((False, None))
        except BaseException as error:
            queue.put((False, error))
        finally:
            if isinstance(items, Generator):  # it ends where it ran
                items.close()

    thread = Thread(target=fill, name="pvg-ahead", daemon=True)
    thread.start()
    try:
        while True:
            more, item = queue.get()
            if not more:
                if isinstance(item, BaseException):
                    raise item
                return
            yield item  # type: ignore[misc]
    finally:
        left.set()
        _drain(queue)  # one more put may be waiting; after it the thread sees that nobody listens
        thread.join()


def _drain(queue: Queue[tuple[bool, T | BaseException | None]]) -> None:
    try:
        while True:
            queue.get_nowait()
    except Empty:
        pass


class Sink(Generic[T]):
    """Calls `work` on each item in a thread, at most `DEPTH` items behind; a context manager.

    The first error of `work` is raised by the next `put`, or on leaving, and later items are dropped. Leaving the
    block waits for the items that were put, unless it is left by an error.
    """

    def __init__(self, work: Callable[[T], None]) -> None:
        self._work = work
        self._queue: Queue[T | None] = Queue(DEPTH)
        self._error: BaseException | None = None
        self._thread = Thread(target=self._run, name="pvg-sink", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._error is not None:
                continue
            try:
                self._work(item)
            except BaseException as error:  # raised where the results are awaited
                self._error = error

    def put(self, item: T) -> None:
        """Hand over the next item. Raises what `work` raised on an earlier one."""
        if self._error is not None:
            raise self._error
        self._queue.put(item)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None and self._error is None:
            self._error = error  # items still waiting are dropped
        self._queue.put(None)
        self._thread.join()
        if kind is None and self._error is not None:
            raise self._error
