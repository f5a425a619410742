"""Those who wait for single pictures: one look at the records for all of them, often, as long as there is anybody."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection
from typing import Final

import structlog

from service.api.calls import Calls
from service.catalog import Preview

log = structlog.get_logger(__name__)

#: seconds between two looks
POLL_S: Final = 0.02


class PreviewWatch:
    """Tells those that wait for a picture of its end. Nobody who waits holds a thread.

    ``load`` gives those of some requests that have ended, and the ids of those that are still there.
    """

    def __init__(
        self, calls: Calls, load: Callable[[Collection[str]], tuple[Collection[Preview], Collection[str]]]
    ) -> None:
        self._calls = calls
        self._load = load
        self._waiting: dict[str, set[asyncio.Future[Preview | None]]] = {}
        self._task: asyncio.Task[None] | None = None

    async def end_of(self, preview_id: str, seconds: float) -> Preview | None:
        """The picture once it is made or cannot be; None when it is not by then, or its medium was deleted."""
        waiter: asyncio.Future[Preview | None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(preview_id, set()).add(waiter)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._look())
        try:
            async with asyncio.timeout(seconds):
                return await waiter
        except TimeoutError:
            return None
        finally:
            waiters = self._waiting[preview_id]
            waiters.discard(waiter)
            if not waiters:
                del self._waiting[preview_id]

    async def _look(self) -> None:
        is_away = False
        while self._waiting:
            await asyncio.sleep(POLL_S)
            asked = list(self._waiting)
            try:
                ended, there = await self._calls.read(self._load, asked)
            except Exception as error:  # their time runs out, and they are told
                if not is_away:
                    log.warning("pictures that are waited for cannot be looked at", error=type(error).__name__)
                is_away = True
                continue
            if is_away:
                log.info("pictures that are waited for can be looked at again")
            is_away = False
            for preview in ended:
                self._tell(preview.id, preview)
            for gone in set(asked).difference(there):
                self._tell(gone, None)

    def _tell(self, preview_id: str, preview: Preview | None) -> None:
        for waiter in self._waiting.get(preview_id, ()):
            if not waiter.done():
                waiter.set_result(preview)
