"""Encoders that take the machine for themselves are put back among the others."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_THREADS = Path("/proc/self/task")


@contextmanager
def kept_scheduling() -> Iterator[None]:
    """What is opened meanwhile leaves the threads of this process in the scheduling class of the one that opens it.

    SVT-AV1 of root puts its threads, and the one that opens it, into SCHED_FIFO at the highest priority, and leaves the
    latter there: from then on the process and all that it starts go before everything else on the machine, and share
    time with nobody (sched(7)). Elsewhere than on Linux nothing is done.
    """
    if not hasattr(os, "sched_getscheduler") or not _THREADS.exists():
        yield
        return
    own, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    before = _classes()
    try:
        yield
    finally:
        for thread, given in _classes().items():
            if given != before.get(thread, own):
                with suppress(OSError):  # it has ended
                    os.sched_setscheduler(thread, own, priority)


def _classes() -> dict[int, int]:
    found = {}
    for entry in _THREADS.iterdir():
        with suppress(OSError):  # it has ended
            found[int(entry.name)] = os.sched_getscheduler(int(entry.name))
    return found
