"""Waiting for a database or an object store that is away: a job goes on when they are back."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import structlog

from service.outages import is_outage, told

log = structlog.get_logger(__name__)

T = TypeVar("T")

_FIRST_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 2.0


class Patience:
    """Makes a call again and again while what it needs is away, for at most ``limit_s`` seconds.

    ``passes`` says which errors are waited for.

    ``check`` is called between two tries, and raises when there is no use in waiting. A call may have had its effect
    although it failed: an answer can be lost on the way. The next one must see that.
    """

    def __init__(
        self, check: Callable[[], None], *, limit_s: float, passes: Callable[[BaseException], bool] = is_outage
    ) -> None:
        self._check = check
        self._passes = passes
        self._limit_s = limit_s

    def __call__(self, call: Callable[[], T]) -> T:
        """What the call answers at last. Raises its error when it does not pass, or lasts too long."""
        until = time.monotonic() + self._limit_s
        pause = _FIRST_PAUSE_S
        while True:
            try:
                answer = call()
            except Exception as error:
                if not self._passes(error) or time.monotonic() >= until:
                    raise
                if pause == _FIRST_PAUSE_S:
                    log.warning("waiting for what is away", **told(error))
            else:
                if pause > _FIRST_PAUSE_S:
                    log.info("what was away is back")
                return answer
            self._check()
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE_S)
