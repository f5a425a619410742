"""Waiting for what comes about in its own time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def until(reached: Callable[[], T], seconds: float = 60, *, said: Callable[[], object] = str) -> T:
    """What ``reached`` answers as soon as that is true; after so many seconds the test fails with what is ``said``."""
    end = time.monotonic() + seconds
    while not (found := reached()):
        assert time.monotonic() < end, said()
        time.sleep(0.02)
    return found
