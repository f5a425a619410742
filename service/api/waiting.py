"""Clients that wait for a change of a job: one look at the records for all of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

import structlog

from service.api.calls import Calls
from service.catalog.jobs import Standing

log = structlog.get_logger(__name__)

#: seconds between two looks
POLL_S: Final = 0.15
#: seconds between two looks at the places of queued jobs, which others move
PLACES_S: Final = 3.0


@dataclass(frozen=True)
class Snapshot:
    """A job as it stood at one moment, its place in the queue, and the answer that shows it, as JSON."""

    standing: Standing
    body: bytes
    position: int | None = None


@dataclass(eq=False)
class _Waiter:
    wanted: Callable[[Standing], bool]
    #: the place that is known, of who wants to hear of another one as well
    known: Snapshot | None = None
    told: asyncio.Future[Snapshot | None] = field(default_factory=lambda: asyncio.get_running_loop().create_future())

    def wants(self, snapshot: Snapshot) -> bool:
        is_elsewhere = self.known is not None and snapshot.position != self.known.position
        return is_elsewhere or self.wanted(snapshot.standing)

    def tell(self, snapshot: Snapshot | None) -> None:
        if not self.told.done():
            self.told.set_result(snapshot)


class JobWatch:
    """Tells those that wait for a job of its end, or of any change. Nobody who waits holds a thread.

    ``stand`` says how some jobs stand, by one small query; ``load`` gives the answers for some of them: one a job,
    however many wait for it. Places in the queue take more than that to know, and are looked at each `PLACES_S`.
    """

    def __init__(
        self,
        calls: Calls,
        stand: Callable[[Collection[str]], Mapping[str, Standing]],
        load: Callable[[Collection[str]], Mapping[str, Snapshot]],
    ) -> None:
        self._calls = calls
        self._stand = stand
        self._load = load
        self._waiting: dict[str, set[_Waiter]] = {}
        self._task: asyncio.Task[None] | None = None
        self._placed = float("-inf")
        self.is_closed = False

    async def end_of(self, job_id: str, seconds: float) -> bytes | None:
        """The answer for a job once it has ended.

        None when the time is over before, the service stops, or its record is deleted.
        """
        snapshot = await self._wait(job_id, lambda standing: standing.has_ended, seconds)
        return None if snapshot is None else snapshot.body

    async def change_of(self, job_id: str, known: Snapshot, seconds: float) -> Snapshot | None:
        """The job once it stands otherwise than ``known``, or at another place in the queue.

        None when the time is over before, the service stops, or its record is deleted. Of several changes between two
        looks the last one is told.
        """
        return await self._wait(job_id, lambda standing: standing != known.standing, seconds, known)

    async def _wait(
        self, job_id: str, wanted: Callable[[Standing], bool], seconds: float, known: Snapshot | None = None
    ) -> Snapshot | None:
        if self.is_closed:
            return None
        waiter = _Waiter(wanted, known)
        self._waiting.setdefault(job_id, set()).add(waiter)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._look())
        try:
            async with asyncio.timeout(seconds):
                return await waiter.told
        except TimeoutError:
            return None
        finally:
            self._forget(job_id, waiter)

    def close(self) -> None:
        """Let everybody go who waits, and nobody wait any more: the service stops."""
        self.is_closed = True
        self._let_go(list(self._waiting))

    def _let_go(self, job_ids: Iterable[str]) -> None:
        """Tell who waits for these jobs that there is nothing to wait for."""
        for job_id in job_ids:
            for waiter in self._waiting.get(job_id, ()):
                waiter.tell(None)

    def _forget(self, job_id: str, waiter: _Waiter) -> None:
        waiters = self._waiting[job_id]
        waiters.discard(waiter)
        if not waiters:
            del self._waiting[job_id]

    async def _look(self) -> None:
        is_away = False
        while self._waiting:
            await asyncio.sleep(POLL_S)
            try:
                await self._tell_changes()
            except Exception as error:  # each of them asks for itself in the end, and is told
                if not is_away:
                    log.warning("jobs that are waited for cannot be looked at", error=type(error).__name__)
                is_away = True
            else:
                if is_away:
                    log.info("jobs that are waited for can be looked at again")
                is_away = False

    async def _tell_changes(self) -> None:
        asked = list(self._waiting)
        standings = await self._calls.read(self._stand, asked)
        self._let_go(job_id for job_id in asked if job_id not in standings)
        places = (now := asyncio.get_running_loop().time()) - self._placed >= PLACES_S
        changed = [
            job_id
            for job_id, standing in standings.items()
            if any(
                waiter.wanted(standing) or (places and waiter.known is not None and standing.has_place)
                for waiter in self._waiting.get(job_id, ())
            )
        ]
        if places:
            self._placed = now
        if not changed:
            return
        for job_id, snapshot in (await self._calls.read(self._load, changed)).items():
            for waiter in list(self._waiting.get(job_id, ())):
                if waiter.wants(snapshot):
                    waiter.tell(snapshot)
