"""How many answers that do not end by themselves there may be: they must not take all connections."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Final

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from service.api.per_owner import PerOwner
from service.errors import Limit, QuotaExceededError, UnavailableError

#: of one key, or of nobody, at a time in one process
PER_OWNER: Final = 100


class Streams:
    """Counts the streams of one API: up to ``limit``, and `PER_OWNER` of each caller."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._of = PerOwner()

    @property
    def open(self) -> int:
        """How many there are."""
        return self._of.total

    @contextmanager
    def place(self, owner: str) -> Iterator[None]:
        """Have a place for a stream inside the block.

        Raises `QuotaExceededError` or `UnavailableError` when there is none.
        """
        if self._of.held(owner) >= PER_OWNER:
            raise QuotaExceededError(
                f"a key may have {PER_OWNER} streams of events",
                headers={"Retry-After": "5"},
                limit=Limit(PER_OWNER, "streams"),
            )
        if self._of.total >= self._limit:
            raise UnavailableError("there are too many streams of events; ask with ?wait= instead")
        with self._of.one_more(owner):
            yield


class EventStream(StreamingResponse):
    """Events, if there is a place for them when the answer begins: what it raises then is answered instead."""

    media_type = "text/event-stream"

    def __init__(self, streams: Streams, owner: str, events: AsyncIterator[bytes]) -> None:
        # nginx would keep events back until its buffer is full
        super().__init__(events, headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})
        self._streams = streams
        self._owner = owner

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer; a HEAD with what a stream begins with, for it has no end to wait for."""
        if scope["method"] == "HEAD":
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            await send({"type": "http.response.body"})
            return
        with self._streams.place(self._owner):
            await super().__call__(scope, receive, send)
