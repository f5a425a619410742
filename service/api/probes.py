"""Checks of the parts a service needs, each made at most once every `KEEP_S` seconds however often it is asked for.

Whoever asks whether the service is ready needs no key, and some checks write: all who ask meanwhile share one check and
what it found.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Final, Literal

import structlog

from service.api.calls import Calls
from service.outages import is_disk_full

State = Literal["ok", "full", "unavailable"]

OK: Final = "ok"
FULL: Final = "full"
UNAVAILABLE: Final = "unavailable"

log = structlog.get_logger(__name__)

#: seconds for which what a check found is told
KEEP_S = 2.0


class Probe:
    """One shared check. ``check`` raises when the part of this ``name`` does not answer."""

    def __init__(self, name: str, calls: Calls, check: Callable[[], object]) -> None:
        self._name = name
        self._calls = calls
        self._check = check
        self._running: asyncio.Task[State] | None = None
        self._ended = -math.inf

    async def state(self) -> State:
        """Whether the part answers, or did a moment ago. One that is full reads and deletes, and takes nothing new."""
        now = asyncio.get_running_loop().time()
        if self._running is None or (self._running.done() and now - self._ended >= KEEP_S):
            self._running = asyncio.create_task(self._ask())
        return await asyncio.shield(self._running)  # one who goes away does not take it from the others

    async def _ask(self) -> State:
        try:
            await self._calls.read(self._check)
        except Exception as error:
            is_full = is_disk_full(error)
            log.warning("full" if is_full else "not ready", part=self._name, error=type(error).__name__)
            return FULL if is_full else UNAVAILABLE
        finally:
            self._ended = asyncio.get_running_loop().time()
        return OK
