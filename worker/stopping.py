"""A worker that is told to stop: its pool children see it at once, and the time it takes is bounded.

Celery's warm shutdown waits for the children without end and tells them nothing.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from typing import Final

import structlog
from billiard.exceptions import WorkerLostError

from worker.shared_moment import SharedMoment

log = structlog.get_logger(__name__)

#: when the worker was told to stop
_asked: Final = SharedMoment()

#: seconds after which a worker that was told to stop takes no more messages: its loop looks that often
_SETTLED_S: Final = 2.2
#: how far a job is from which on this tells how long the rest takes
_BEGUN: Final = 0.05
#: of a worker that does not end in time: seconds until its last line is given up, and until the kernel ends it
_TOLD_S: Final = 0.5
_KERNEL_S: Final = 1.0


class StoppedError(Exception):
    """The worker has to stop: the job goes back to the queue."""


def ask() -> None:
    """Tell this process, and those forked from it, to stop."""
    _asked.begin(time.monotonic())


def asked_at() -> float | None:
    """When the worker was told to stop, by `time.monotonic`; None while it was not."""
    return _asked.at


def check() -> None:
    """Raise `StoppedError` when the worker was told to stop."""
    if asked_at() is not None:
        raise StoppedError


def settle() -> None:
    """Wait until a message that is sent goes to another worker: this one would keep it until it has stopped."""
    asked = asked_at()
    if asked is not None:
        time.sleep(max(0.0, asked + _SETTLED_S - time.monotonic()))


def end_within(seconds: float) -> None:
    """End this process after so many seconds, with status 0, and its children with it (`worker.lifeline`).

    Their jobs are given back by then. It does nothing for a process that ends by itself before. A thread does it, since
    the kernel passes over a signal without a handler that is for the first process of a container, and gives others
    the status of a failure. Should the thread not run, it is the kernel all the same, a second later.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds + _KERNEL_S)
    threading.Thread(target=_end_after, args=(seconds,), name="deadline", daemon=True).start()


def _end_after(seconds: float) -> None:
    time.sleep(seconds)
    # in a thread of its own: who reads the log may be what hangs
    line = "the worker does not end by itself, and is ended; what it still has is queued again"
    told = threading.Thread(target=log.warning, args=(line,), daemon=True)
    told.start()
    told.join(_TOLD_S)
    os._exit(0)  # the log is written line by line, and nothing else waits to be written


def is_no_loss(record: logging.LogRecord) -> bool:
    """A filter of Celery's log: a child that the stop has ended is told in a plain line, for its job is given back.

    A service manager sends its signal to all processes of a worker, and Celery takes the end of a child for an error.
    """
    lost = isinstance(record.args, tuple) and any(isinstance(one, WorkerLostError) for one in record.args)
    if lost and asked_at() is not None:
        _to_info(record)
        record.msg, record.args = "a process of the pool has ended with its worker", ()
        record.exc_info = record.exc_text = None
    return True


def is_no_fault(record: logging.LogRecord) -> bool:
    """A filter of the pool's log: that a child was ended by the signal that its worker got too is no error."""
    is_end = str(record.msg).startswith("Process %r pid:%r exited with")
    if is_end and record.levelno >= logging.ERROR and asked_at() is not None:
        _to_info(record)
    return True


def _to_info(record: logging.LogRecord) -> None:
    record.levelno, record.levelname = logging.INFO, logging.getLevelName(logging.INFO)


def may_go_on(began: float, fraction: float | None, *, grace_s: float) -> bool:
    """Whether a job is about to end: a worker that is told to stop gives the others back at once.

    ``began`` is when it was begun, by `time.monotonic`, and ``fraction`` in [0, 1] how far it is. The rest of it takes
    as long in proportion, and must fit into ``grace_s`` seconds from when the worker was told. One that has hardly
    begun is taken to be at a twentieth, but not before its message may be sent (`settle`): until then it can show more
    at no cost. One that has told nothing yet, None, may be a picture, which tells nothing until its end: it has half of
    the time to end in.
    """
    asked = asked_at()
    if asked is None:
        return True
    now = time.monotonic()
    if fraction is None:
        return now < asked + grace_s / 2
    if fraction < _BEGUN and now < asked + min(_SETTLED_S, grace_s):
        return True
    done = max(fraction, _BEGUN)
    return now + (now - began) * (1 - done) / done < asked + grace_s
