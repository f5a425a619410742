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
from service.catalog import Database, keys
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
    #: whoever comes before anything is known waits for the first reading
    first: asyncio.Lock = field(default_factory=asyncio.Lock)


class Share:
    """What arrives by one request."""

    def __init__(self, arriving: Arriving, owner: str, account: _Account) -> None:
        self._arriving = arriving
        self._owner = owner
        self._account = account
        self._size_bytes = 0
        #: of them, those that are announced and not here yet
        self._ahead_bytes = 0

    async def reserve(self, size_bytes: int) -> None:
        """So many bytes are announced: they count from now on. Raises `QuotaExceededError` when they are too many.

        So of files that do not fit together the first are taken whole, and the others refused before they come.
        """
        if not self._is_free:
            await self._admit(size_bytes)
            self._ahead_bytes += size_bytes

    async def take(self, size_bytes: int) -> None:
        """So many more bytes are here. Raises `QuotaExceededError` when those not announced are too many."""
        if not self._is_free:
            announced = min(size_bytes, self._ahead_bytes)
            self._ahead_bytes -= announced
            if size_bytes > announced:
                await self._admit(size_bytes - announced)

    async def _admit(self, size_bytes: int) -> None:
        await self._arriving.admit(self._owner, self._account, size_bytes, own_bytes=self._size_bytes)
        self._size_bytes += size_bytes

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

    async def admit(self, owner: str, account: _Account, more_bytes: int, *, own_bytes: int = 0) -> None:
        """Count so many bytes more of an owner, of whose bytes ``own_bytes`` are of the same request.

        Raises `QuotaExceededError` when they are too many with what arrives already, and counts none.
        """
        while not await self._has_room(owner, account, more_bytes):
            await asyncio.sleep(_SECOND_LOOK_S)
            others = account.size_bytes - own_bytes
            await self._calls.read(self._check, owner, own_bytes + more_bytes, others)
            account.read_at = -math.inf
        account.size_bytes += more_bytes

    async def _has_room(self, owner: str, account: _Account, more_bytes: int) -> bool:
        """Whether so many bytes more fit, by what was recorded of an owner when it was last read."""
        if not account.is_known:
            async with account.first:
                if not account.is_known:
                    await self._read(owner, account)
        elif asyncio.get_running_loop().time() - account.read_at > _READ_AGAIN_S:
            await self._read(owner, account)
        return account.left is None or account.size_bytes + more_bytes <= account.left

    async def _read(self, owner: str, account: _Account) -> None:
        account.read_at = asyncio.get_running_loop().time()  # others go on by what was read last meanwhile
        try:
            account.left = await self._calls.read(self._left, owner)
            account.is_known = True
        except Exception as error:
            # an outage ends no request that was under way: what was read last holds meanwhile
            if not account.is_known or not (isinstance(error, UnavailableError) or is_outage(error)):
                raise

    def _left(self, owner: str) -> int | None:
        with self._database.read() as session:
            return quotas.left_bytes(session, owner)

    def _check(self, owner: str, size_bytes: int, others_bytes: int) -> None:
        with self._database.read() as session:
            quotas.check_bytes(
                session, owner, keys.get(session, owner), size_bytes, now=self._database.now(), arriving=others_bytes
            )
