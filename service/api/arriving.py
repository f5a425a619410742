"""Bytes on their way: an owner's quota bounds them together with what is recorded."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Final

from service.api import quotas
from service.api.calls import Calls
from service.catalog import Database
from service.errors import UnavailableError
from service.outages import is_outage

#: seconds after which what is recorded of an owner is read again while its bytes arrive: others may record some too
_READ_AGAIN_S: Final = 2.0
#: before bytes are refused: what another request had is counted as arriving until a moment after it is recorded
_SECOND_LOOK_S: Final = 0.5


@dataclass
class _Account:
    """What arrives for one owner."""

    size_bytes: int = 0
    places: int = 0
    #: by name, what is not counted
    free: dict[str, Share] = field(default_factory=dict)
    #: bytes that fit besides what is recorded, by when they were read; None for no bound
    left: int | None = None
    read_at: float = -math.inf
    is_known: bool = False


class Share:
    """What arrives by one request."""

    def __init__(self, arriving: Arriving, owner: str, account: _Account) -> None:
        self._arriving = arriving
        self._owner = owner
        self._account = account
        self._size_bytes = 0

    async def fits(self, size_bytes: int) -> None:
        """Raise `QuotaExceededError` when so many bytes more are too many."""
        if not self._is_free:
            await self._arriving.check(self._owner, self._account, size_bytes)

    async def take(self, size_bytes: int) -> None:
        """So many more bytes are here. Raises `QuotaExceededError` when they are too many."""
        if not self._is_free:
            self._size_bytes += size_bytes
            self._account.size_bytes += size_bytes
            await self.fits(0)

    def give_back(self, size_bytes: int | None = None) -> None:
        """So many of the bytes, or all, are recorded by now or gone: they arrive no longer."""
        given = self._size_bytes if size_bytes is None else min(size_bytes, self._size_bytes)
        self._size_bytes -= given
        self._account.size_bytes -= given
        self._account.read_at = -math.inf

    @property
    def _is_free(self) -> bool:
        return self in self._account.free.values()


class Arriving:
    """What arrives at one API, by owner. For its event loop alone.

    Of what arrives at others it knows what is recorded.
    """

    def __init__(self, calls: Calls, database: Database) -> None:
        self._calls = calls
        self._database = database
        self._of: dict[str, _Account] = {}

    @asynccontextmanager
    async def place(self, owner: str, *, free: str | None = None) -> AsyncIterator[Share]:
        """Inside the block the bytes of a request count, but for the newest at a time that is ``free`` by this name.

        That is for bytes that are counted already, or are there: those of an announced upload, a request sent again.
        Who goes on after a lost connection is the newest, while the former request is not known to be dead.
        """
        account = self._of.setdefault(owner, _Account())
        account.places += 1
        share = Share(self, owner, account)
        if free is not None:
            account.free[free] = share
        try:
            yield share
        finally:
            if free is not None and account.free.get(free) is share:
                del account.free[free]
            share.give_back()
            account.places -= 1
            if not account.places:
                del self._of[owner]

    async def check(self, owner: str, account: _Account, more_bytes: int) -> None:
        """Raise `QuotaExceededError` when what arrives, and so many bytes more, are too many for an owner."""
        now = asyncio.get_running_loop().time
        if now() - account.read_at > _READ_AGAIN_S:
            account.read_at = now()
            try:
                account.left = await self._calls.read(self._left, owner)
                account.is_known = True
            except Exception as error:
                # an outage ends no request that was under way: what was read last holds meanwhile
                if not account.is_known or not (isinstance(error, UnavailableError) or is_outage(error)):
                    raise
        if account.left is None or account.size_bytes + more_bytes <= account.left:
            return
        await asyncio.sleep(_SECOND_LOOK_S)
        await self._calls.read(self._check, owner, account.size_bytes + more_bytes)
        account.read_at = -math.inf

    def _left(self, owner: str) -> int | None:
        with self._database.read() as session:
            return quotas.left_bytes(session, owner)

    def _check(self, owner: str, size_bytes: int) -> None:
        with self._database.read() as session:
            quotas.check(session, owner, now=self._database.now(), jobs=0, size_bytes=size_bytes, lock=False)
