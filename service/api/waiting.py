"""Clients that wait for a change of a job, or for a single picture: one look at the records for all of them."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Generic, TypeVar

import structlog

from service.api.calls import Calls
from service.catalog import Preview
from service.catalog.jobs import Standing

log = structlog.get_logger(__name__)

#: seconds between two looks at jobs
POLL_S: Final = 0.15
#: seconds between two looks at the places of queued jobs, which others move
PLACES_S: Final = 3.0
#: seconds between two looks at pictures
PICTURES_POLL_S: Final = 0.02

T = TypeVar("T")
W = TypeVar("W", bound="_Waiter[Any]")


@dataclass(eq=False)
class _Waiter(Generic[T]):
    told: asyncio.Future[T | None] = field(
        default_factory=lambda: asyncio.get_running_loop().create_future(), kw_only=True
    )

    def tell(self, what: T | None) -> None:
        if not self.told.done():
            self.told.set_result(what)


class _Watch(ABC, Generic[W, T]):
    """Those that wait, by the id of what they wait for; as long as there is anybody, the records are looked at.

    Nobody who waits holds a thread. ``things`` is what the log calls what is waited for.
    """

    def __init__(self, things: str, poll_s: float) -> None:
        self._things = things
        self._poll_s = poll_s
        self._waiting: dict[str, set[W]] = {}
        self._task: asyncio.Task[None] | None = None

    @abstractmethod
    async def _tell_news(self, asked: Collection[str]) -> None:
        """Look at these things, and tell those that wait for one what has become of it."""

    async def _wait(self, thing_id: str, waiter: W, seconds: float) -> T | None:
        """What the waiter is told; None when the time is over before."""
        self._waiting.setdefault(thing_id, set()).add(waiter)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._look())
        try:
            async with asyncio.timeout(seconds):
                told: T | None = await waiter.told
                return told
        except TimeoutError:
            return None
        finally:
            self._forget(thing_id, waiter)

    def _forget(self, thing_id: str, waiter: W) -> None:
        waiters = self._waiting[thing_id]
        waiters.discard(waiter)
        if not waiters:
            del self._waiting[thing_id]

    def _waiters(self, thing_id: str) -> tuple[W, ...]:
        return tuple(self._waiting.get(thing_id, ()))

    def _let_go(self, thing_ids: Iterable[str]) -> None:
        """Tell those that wait for these things that there is nothing to wait for."""
        for thing_id in thing_ids:
            for waiter in self._waiters(thing_id):
                waiter.tell(None)

    async def _look(self) -> None:
        is_away = False
        while self._waiting:
            await asyncio.sleep(self._poll_s)
            try:
                await self._tell_news(list(self._waiting))
            except Exception as error:  # their time runs out, and they are answered without
                if not is_away:
                    log.warning(f"{self._things} that are waited for cannot be looked at", error=type(error).__name__)
                is_away = True
            else:
                if is_away:
                    log.info(f"{self._things} that are waited for can be looked at again")
                is_away = False


@dataclass(frozen=True)
class Snapshot:
    """A job as it stood at one moment, its place in the queue, and the answer that shows it, as JSON."""

    standing: Standing
    body: bytes
    position: int | None = None


@dataclass(eq=False)
class _JobWaiter(_Waiter[Snapshot]):
    wanted: Callable[[Standing], bool]
    #: the place that is known, of who wants to hear of another one as well
    known: Snapshot | None = None

    def wants(self, snapshot: Snapshot) -> bool:
        is_elsewhere = self.known is not None and snapshot.position != self.known.position
        return is_elsewhere or self.wanted(snapshot.standing)


class JobWatch(_Watch[_JobWaiter, Snapshot]):
    """Tells those that wait for a job of its end, or of any change.

    ``stand`` says how some jobs stand, by one small query; ``load`` gives the answers for some of them: one a job,
    however many wait for it. Places in the queue take more than that to know, and are looked at each `PLACES_S`.
    """

    def __init__(
        self,
        calls: Calls,
        stand: Callable[[Collection[str]], Mapping[str, Standing]],
        load: Callable[[Collection[str]], Mapping[str, Snapshot]],
    ) -> None:
        super().__init__("jobs", POLL_S)
        self._calls = calls
        self._stand = stand
        self._load = load
        self._placed = float("-inf")
        self.is_closed = False

    async def end_of(self, job_id: str, seconds: float) -> bytes | None:
        """The answer for a job once it has ended.

        None when the time is over before, the service stops, or its record is deleted.
        """
        snapshot = await self._change(job_id, _JobWaiter(lambda standing: standing.has_ended), seconds)
        return None if snapshot is None else snapshot.body

    async def change_of(self, job_id: str, known: Snapshot, seconds: float) -> Snapshot | None:
        """The job once it stands otherwise than ``known``, or at another place in the queue.

        None when the time is over before, the service stops, or its record is deleted. Of several changes between two
        looks the last one is told.
        """
        return await self._change(job_id, _JobWaiter(lambda standing: standing != known.standing, known), seconds)

    async def _change(self, job_id: str, waiter: _JobWaiter, seconds: float) -> Snapshot | None:
        return None if self.is_closed else await self._wait(job_id, waiter, seconds)

    def close(self) -> None:
        """Let everybody go who waits, and nobody wait any more: the service stops."""
        self.is_closed = True
        self._let_go(list(self._waiting))

    async def _tell_news(self, asked: Collection[str]) -> None:
        standings = await self._calls.read(self._stand, asked)
        self._let_go(job_id for job_id in asked if job_id not in standings)
        places = (now := asyncio.get_running_loop().time()) - self._placed >= PLACES_S
        changed = [
            job_id
            for job_id, standing in standings.items()
            if any(
                waiter.wanted(standing) or (places and waiter.known is not None and standing.has_place)
                for waiter in self._waiters(job_id)
            )
        ]
        if places:
            self._placed = now
        if not changed:
            return
        for job_id, snapshot in (await self._calls.read(self._load, changed)).items():
            for waiter in self._waiters(job_id):
                if waiter.wants(snapshot):
                    waiter.tell(snapshot)


class PreviewWatch(_Watch[_Waiter[Preview], Preview]):
    """Tells those that wait for a picture of its end.

    ``load`` gives those of some requests that have ended, and the ids of those that are still there.
    """

    def __init__(
        self, calls: Calls, load: Callable[[Collection[str]], tuple[Collection[Preview], Collection[str]]]
    ) -> None:
        super().__init__("pictures", PICTURES_POLL_S)
        self._calls = calls
        self._load = load

    async def end_of(self, preview_id: str, seconds: float) -> Preview | None:
        """The picture once it is made or cannot be; None when it is not by then, or its medium was deleted."""
        return await self._wait(preview_id, _Waiter(), seconds)

    async def _tell_news(self, asked: Collection[str]) -> None:
        ended, there = await self._calls.read(self._load, asked)
        for preview in ended:
            for waiter in self._waiters(preview.id):
                waiter.tell(preview)
        self._let_go(set(asked).difference(there))
