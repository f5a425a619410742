"""Files that are fetched from where a client says they are: how many at a time, and only while the client waits."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from typing import Final, TypeVar

from starlette.requests import ClientDisconnect, Request

from service.api.per_owner import PerOwner
from service.errors import Limit, QuotaExceededError, UnavailableError

T = TypeVar("T")

#: of one key, or of nobody, at a time in one process
PER_OWNER: Final = 8
#: in one process
IN_ALL: Final = 64


class Fetches:
    """Counts the fetches of one API: up to `IN_ALL`, and `PER_OWNER` of each caller."""

    def __init__(self) -> None:
        self._of = PerOwner()

    @contextmanager
    def place(self, owner: str) -> Iterator[None]:
        """Inside the block a fetch counts. Raises `QuotaExceededError` or `UnavailableError` when there is no place."""
        if self._of.held(owner) >= PER_OWNER:
            raise QuotaExceededError(
                f"a key may have {PER_OWNER} files fetched at a time; wait for them",
                headers={"Retry-After": "5"},
                limit=Limit(PER_OWNER, "files"),
            )
        if self._of.total >= IN_ALL:
            raise UnavailableError("too many files are being fetched; try again")
        with self._of.one_more(owner):
            yield


async def while_connected(request: Request, work: Coroutine[None, None, T]) -> T:
    """What the work returns; it is canceled when the client goes away.

    The body of the request must have been read. Raises `ClientDisconnect`, and what the work raises.
    """
    working, gone = asyncio.create_task(work), asyncio.create_task(_gone(request))
    try:
        await asyncio.wait({working, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise ClientDisconnect
        return working.result()
    finally:
        working.cancel()
        gone.cancel()
        # what the work holds is given back before the block around it ends
        await asyncio.gather(working, gone, return_exceptions=True)


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
