"""How many requests a key may make in a minute, over all processes of the API, without a write for each of them.

A process takes a share of the minute's requests from the database and counts it down by itself. What is handed out
never exceeds the limit, however many processes there are; what a process does not use of its last share is lost until
the next minute begins. A share is a twentieth of the limit, so that a key costs a process at most some twenty writes
a minute, refusals none.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import Final

from sqlalchemy.exc import DBAPIError

from service.catalog import Database, windows
from service.catalog.windows import WINDOW_S, Share
from service.errors import Limit, QuotaExceededError
from service.outages import is_disk_full

_SHARES: Final = 20
#: in a window, by one link
LINK_REQUESTS: Final = 600


@dataclass(frozen=True)
class Standing:
    """Where a key stands after a request: requests that are left, and seconds until the window ends."""

    granted: bool
    limit: int
    left: int
    resets_s: int

    @property
    def headers(self) -> dict[str, str]:
        """RateLimit header fields, as of draft-ietf-httpapi-ratelimit-headers-10."""
        return {
            "RateLimit-Policy": f'"requests";q={self.limit};w={WINDOW_S}',
            "RateLimit": f'"requests";r={self.left};t={self.resets_s}',
        }


class LinkRates:
    """The requests of this minute by each link, as far as this process answers them.

    They are apart from those of its key, which whoever has a link could use up. For an event loop alone.
    """

    def __init__(self) -> None:
        self._now = time.monotonic
        self._window = -1
        self._of: Counter[str] = Counter()

    def take(self, link: str) -> None:
        """Count a request. Raises `QuotaExceededError` when there are too many."""
        now_s = self._now()
        if (window := int(now_s // WINDOW_S)) != self._window:
            self._window, self._of = window, Counter()
        if self._of[link] >= LINK_REQUESTS:
            raise QuotaExceededError(
                f"{LINK_REQUESTS} requests a minute may come by a link",
                headers={"Retry-After": str(math.ceil((window + 1) * WINDOW_S - now_s))},
                limit=Limit(LINK_REQUESTS, "requests per minute"),
            )
        self._of[link] += 1


@dataclass
class _Held:
    """What one process holds of a key's window."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    window: int = -1
    mine: int = 0
    #: not handed out to any process when this one last asked
    others: int = 0

    def is_stale(self, window: int) -> bool:
        """It is of a window that is over, or, since the clock was set back, of one that is yet to come."""
        return self.window < window or windows.is_ahead(self.window, window)


class Rates:
    """The requests of every key, as far as this process handles them. Safe to use from several threads."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._held: defaultdict[str, _Held] = defaultdict(_Held)

    def take_held(self, key_id: str, limit: int) -> Standing | None:
        """Count one request of what this process holds, without waiting; None when only `take` can tell."""
        now_s = self._database.now().timestamp()
        window = int(now_s // WINDOW_S)
        held = self._held[key_id]
        if not held.lock.acquire(blocking=False):
            return None
        try:
            if held.is_stale(window) or (held.mine == 0 and held.others > 0):
                return None
            return _count(held, limit, now_s)
        finally:
            held.lock.release()

    def take(self, key_id: str, limit: int) -> Standing:
        """Count one request of a key that may make ``limit`` in a window, with a new share if there is need of one."""
        now_s = self._database.now().timestamp()
        window = int(now_s // WINDOW_S)
        held = self._held[key_id]
        with held.lock:
            if held.is_stale(window):
                held.window, held.mine, held.others = window, 0, limit
            if held.mine == 0 and held.others > 0:
                share = self._share(key_id, held, limit)
                held.window, held.mine, held.others = share.window, share.granted, max(0, limit - share.taken)
            return _count(held, limit, now_s)

    def _share(self, key_id: str, held: _Held, limit: int) -> Share:
        wanted = math.ceil(limit / _SHARES)
        try:
            with self._database.write() as session:
                return windows.take_share(session, key_id, window=held.window, wanted=wanted)
        except DBAPIError as error:
            if not is_disk_full(error):
                raise
            # reading and deleting go on: until there is room this process counts by itself
            granted = min(wanted, held.others)
            return Share(held.window, granted, limit - held.others + granted)


def _count(held: _Held, limit: int, now_s: float) -> Standing:
    granted = held.mine > 0
    held.mine -= granted
    ends_s = (held.window + 1) * WINDOW_S
    return Standing(granted, limit, held.mine + held.others, max(1, math.ceil(ends_s - now_s)))
