"""Received files stored between two transactions, so that a slow store holds up nobody who writes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

import structlog

from service.api.services import Services
from service.catalog import tombstones
from service.errors import UnavailableError
from service.outages import is_locked, is_outage

log = structlog.get_logger(__name__)

T = TypeVar("T")

#: seconds after which a request that has waited for others who write already leaves a deletion to the reaper
_SOON_S: Final = 0.5


async def store(services: Services, path: Path, key: str, record: Callable[[], tuple[T, bool]]) -> T:
    """Store a received file under ``key`` and record it. Returns what ``record`` answers.

    ``record`` writes one transaction and says beside its answer whether a record names the key from now on; if not, the
    blob is deleted again. Raises what it raises, and `UnavailableError` when the store takes too long, for this file or
    for those before it.
    """
    calls = services.calls
    await calls.write(services.blobs.expect, key)
    try:
        await calls.store(_put, services, path, key)
        answer, is_used = await calls.write(record)
    except Exception as error:
        # of a commit whose answer is lost it is not known whether the file has a record: its tombstone knows
        if not is_outage(error) or is_locked(error):
            await _discard(services, key, within_s=_SOON_S if is_locked(error) else None)
        if isinstance(error, tombstones.LateError):
            raise UnavailableError("the file took too long to be stored; send it again") from error
        raise
    if not is_used:
        await _discard(services, key)
    return answer


async def _discard(services: Services, key: str, *, within_s: float | None = None) -> None:
    """Delete a blob that has no record, now or by the reaper. Never fails: its tombstone is there already.

    ``within_s`` bounds how long others who write are waited for.
    """
    try:
        async with asyncio.timeout(within_s):
            await services.calls.write(services.blobs.bury, [key])
    except Exception as error:
        log.warning("a blob is deleted later", error=type(error).__name__)
    else:
        await services.calls.remove(services.blobs.delete, [key])


def _put(services: Services, path: Path, key: str) -> None:
    """The file keeps its name as well, in case another request wins and it is needed again."""
    draft = path.with_suffix(".publish")
    draft.hardlink_to(path)
    try:
        services.blobs.send(draft, key)
    finally:
        draft.unlink(missing_ok=True)
