"""Checks of the parts a service needs, each made at most once every `KEEP_S` seconds however often it is asked for.

Whoever asks whether the service is ready needs no key, and some checks write: all who ask meanwhile share one check and
what it found. While a check hangs no other one is begun: each would keep one more thread for as long as the part hangs.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Callable
from typing import Final, Literal

import structlog

from service.api.calls import Calls
from service.errors import UnavailableError
from service.outages import is_disk_full, told

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
        #: held by the thread that checks, which may outlive the patience of all who ask
        self._at_work = threading.Lock()
        #: what the log says of the part as it is
        self._said: dict[str, str] = {}

    async def state(self) -> State:
        """Whether the part answers, or did a moment ago. One that is full reads and deletes, and takes nothing new."""
        now = asyncio.get_running_loop().time()
        if self._running is None or (self._running.done() and now - self._ended >= KEEP_S):
            self._running = asyncio.create_task(self._ask())
        return await asyncio.shield(self._running)  # one who goes away does not take it from the others

    async def _ask(self) -> State:
        try:
            if self._at_work.locked():
                return UNAVAILABLE
            await self._calls.read(self._work)
        except UnavailableError as error:
            self._say("not ready", error=type(error).__name__, reason="no answer in time")
            return UNAVAILABLE
        except Exception as error:
            state: State = FULL if is_disk_full(error) else UNAVAILABLE
            self._say("full" if state == FULL else "not ready", **told(error))
            return state
        finally:
            self._ended = asyncio.get_running_loop().time()
        self._say("ready again")
        return OK

    def _work(self) -> None:
        with self._at_work:
            self._check()

    def _say(self, event: str, **why: str) -> None:
        """Log how the part is, once for as long as it stays so."""
        before, self._said = self._said, {"event": event, **why}
        if self._said != before and (before or why):
            (log.warning if why else log.info)(event, part=self._name, **why)
