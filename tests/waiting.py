"""Waiting for what comes about in its own time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: seconds between two looks: at first, and where it takes its time, for each look takes some of what is waited for
FIRST_S, LAST_S = 0.02, 0.1


def until(reached: Callable[[], T], seconds: float = 60, *, said: Callable[[], object] = str) -> T:
    """What ``reached`` answers as soon as that is true; after so many seconds the test fails with what is ``said``."""
    end, pause_s = time.monotonic() + seconds, FIRST_S
    while not (found := reached()):
        assert time.monotonic() < end, said()
        time.sleep(pause_s)
        pause_s = longer(pause_s)
    return found


def longer(pause_s: float) -> float:
    """The pause after one of so many seconds."""
    return min(1.05 * pause_s, LAST_S)
