"""The time of leases: the database's, so that machines whose clocks differ agree on when one is over."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Final

from sqlalchemy import Connection, text

Clock = Callable[[], datetime]

#: seconds between two questions
ASK_EVERY_S: Final = 30.0
#: an answer that takes longer is used, and asked for again
_SLOW_S: Final = 1.0
_TIME: Final = text("SELECT clock_timestamp()")


def utc_now() -> datetime:
    """This machine's time, aware, in UTC."""
    return datetime.now(UTC)


def _steady_s() -> float:
    """Seconds that pass whatever is done to the machine's clock, also while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class ServerClock:
    """A database server's time: its last answer, and this machine's steady clock since.

    It is never ahead of the server's clock, and behind it by no more than an answer takes. One that is behind makes
    leases a little shorter, and finds them over a little later; neither takes a job from a worker that is alive.
    """

    def __init__(self) -> None:
        self._known: tuple[datetime, float] | None = None
        self._next_s = 0.0

    @property
    def is_due(self) -> bool:
        """True when the server should be asked again, in a transaction that is open anyway."""
        return self._known is None or _steady_s() >= self._next_s

    def ask(self, connection: Connection) -> None:
        """Ask the server."""
        began = _steady_s()
        said: datetime = connection.execute(_TIME).scalar_one()
        ended = _steady_s()
        self._known = said.astimezone(UTC), ended
        self._next_s = ended + ASK_EVERY_S if ended - began < _SLOW_S else ended

    def now(self) -> datetime | None:
        """The server's time; None before the first answer."""
        if self._known is None:
            return None
        said, at = self._known
        return said + timedelta(seconds=_steady_s() - at)
