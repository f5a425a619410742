"""Calls that use the records, in threads, and none of them for longer than it has something to do.

Requests that wait for a lock hold no thread meanwhile, and those that only read do not queue behind those that write.
What moves a file's bytes has threads of its own: a slow store holds up neither.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from typing import Final, ParamSpec, TypeVar

from anyio import CapacityLimiter, to_thread

from service.errors import UnavailableError
from service.outages import is_locked

P = ParamSpec("P")
T = TypeVar("T")

#: seconds that the database itself may hold a thread of a request that waits for a lock
LOCK_WAIT_S: Final = 0.25
#: threads for requests that write
_WRITERS: Final = 16
#: threads for requests whose file is being stored or deleted
_STORERS: Final = 16
#: seconds after which a request gives up, and is answered 503
_PATIENCE_S: Final = 6.0
#: and after which one that reads tries no more for a lock
_READ_AGAIN_S: Final = 2.0
#: between two tries for a lock
_PAUSES_S: Final = (0.02, 0.1)


class Calls:
    """Where the requests of one API use the records. The errors of a call are raised as they are."""

    def __init__(self) -> None:
        self._writers = CapacityLimiter(_WRITERS)
        self._storers = CapacityLimiter(_STORERS)

    async def read(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a call that changes nothing, again where it met a lock: readers meet one only while SQLite tidies up.

        Raises `UnavailableError` when it takes too long, and the error of a lock that stays.
        """
        until = asyncio.get_running_loop().time() + _READ_AGAIN_S
        try:
            async with asyncio.timeout(_PATIENCE_S):
                while True:
                    try:
                        return await to_thread.run_sync(lambda: call(*args, **kwargs), abandon_on_cancel=True)
                    except Exception as error:
                        if not is_locked(error) or asyncio.get_running_loop().time() >= until:
                            raise
                    await asyncio.sleep(random.uniform(*_PAUSES_S))  # noqa: S311 - only to come apart
        except TimeoutError as error:
            raise UnavailableError("the records do not answer; try again") from error

    async def write(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a call whose first change is in a transaction, again and again while another writer keeps it waiting.

        Raises `UnavailableError` when there is no thread for it, and the error of the lock when it does not get that.
        """
        loop = asyncio.get_running_loop()
        until, missed = loop.time() + _PATIENCE_S, False
        while True:
            try:
                async with asyncio.timeout_at(until):
                    await self._writers.acquire()
            except TimeoutError as error:
                raise UnavailableError("too many requests wait to be written; try again") from error
            try:
                return await to_thread.run_sync(lambda: call(*args, **kwargs))
            except Exception as error:
                if not is_locked(error) or (missed and loop.time() >= until):
                    raise
                if not missed:  # what the call does before its transaction does not count
                    until, missed = loop.time() + _PATIENCE_S, True
            finally:
                self._writers.release()
            await asyncio.sleep(random.uniform(*_PAUSES_S))  # noqa: S311 - only to come apart

    async def store(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a call that moves the bytes of a file, or removes them, once, for as long as the store takes for it."""
        return await to_thread.run_sync(lambda: call(*args, **kwargs), limiter=self._storers)
