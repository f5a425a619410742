"""Calls that use the records, in threads, and none of them for longer than it has something to do.

Requests that wait for a lock hold no thread meanwhile, and those that only read do not queue behind those that write.
What moves a file's bytes has threads of its own: a slow store holds up neither, and one that hangs keeps nobody waiting
for a thread.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from typing import Final, ParamSpec, TypeVar

import structlog
from anyio import CapacityLimiter, to_thread

from service.errors import UnavailableError
from service.outages import is_locked

log = structlog.get_logger(__name__)

P = ParamSpec("P")
T = TypeVar("T")

#: seconds that the database itself may hold a thread of a request that waits for a lock
LOCK_WAIT_S: Final = 0.25
#: threads for requests that write
_WRITERS: Final = 16
#: threads for requests whose file is being stored or deleted
_STORERS: Final = 16
#: threads for requests that ask the store about files, and seconds for which an answer is worth waiting for
_ASKERS: Final = 4
_ANSWER_S: Final = 2.0
#: seconds after which a request gives up, and is answered 503
_PATIENCE_S: Final = 6.0
#: after which one that deletes leaves it to the reaper
_SOON_S: Final = 1.0
#: and after which one that reads tries no more for a lock
_READ_AGAIN_S: Final = 2.0
#: between two tries for a lock
_PAUSES_S: Final = (0.02, 0.1)


class Calls:
    """Where the requests of one API use the records. The errors of a call are raised as they are."""

    def __init__(self) -> None:
        self._writers = CapacityLimiter(_WRITERS)
        self._storers = CapacityLimiter(_STORERS)
        self._askers = CapacityLimiter(_ASKERS)
        #: to be one of them: who waits for this waits no longer than is said here
        self._places = asyncio.Semaphore(_STORERS)

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

    async def store(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Run a call that moves the bytes of a file once, for as long as the store takes for it.

        Raises `UnavailableError` when there is no thread for it, as while the store hangs.
        """
        if not await self._has_place(_PATIENCE_S):
            raise UnavailableError("too many files wait to be stored; try again")
        await self._use_place(call, *args, **kwargs)

    async def ask_store(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a call that asks the store about files, for a request that can do without the answer.

        Raises `UnavailableError` when there is none soon.
        """

        def ask() -> T:
            return call(*args, **kwargs)

        try:
            async with asyncio.timeout(_ANSWER_S):
                return await to_thread.run_sync(ask, limiter=self._askers, abandon_on_cancel=True)
        except TimeoutError as error:
            raise UnavailableError("the storage does not answer; try again") from error

    async def remove(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Run a call that removes files whose tombstones are written; without a thread for it the reaper does it."""
        if await self._has_place(_SOON_S):
            await self._use_place(call, *args, **kwargs)
        else:
            log.warning("too many files are being stored; some are deleted later")

    async def _has_place(self, within_s: float) -> bool:
        try:
            async with asyncio.timeout(within_s):
                return await self._places.acquire()
        except TimeoutError:
            return False

    async def _use_place(self, call: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        try:
            await to_thread.run_sync(lambda: call(*args, **kwargs), limiter=self._storers)
        finally:
            self._places.release()
