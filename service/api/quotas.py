"""What a key may keep and have under way: stored bytes, unfinished jobs and open uploads."""

from __future__ import annotations

import math
import time
from datetime import datetime
from typing import Final

from sqlalchemy.orm import Session

from service.catalog import Key, amounts, keys, resumable
from service.errors import Limit, QuotaExceededError, UnauthorizedError

#: of files that are announced and have not arrived, the same for every owner: nobody sends so many at a time
MAX_OPEN_UPLOADS: Final = 1000
#: seconds after which a key with too many jobs may ask again: a guess, no job's end is known
_JOBS_RETRY_S: Final = 10
#: the same while other files arrive
_ARRIVING_RETRY_S: Final = 5
#: seconds for which what an owner keeps is not counted again for a job, whose results are of a size that nobody knows
_LATELY_S: Final = 2.0
_LONGEST_RETRY_S: Final = 86_400
_UNITS: Final = {"active-jobs": "jobs", "stored-bytes": "bytes", "open-uploads": "uploads"}


class Lately:
    """What owners were found to keep a moment ago: to count it takes the longer the more it is.

    Safe to use from several threads.
    """

    def __init__(self) -> None:
        self._found: dict[str, tuple[float, int]] = {}

    def note(self, owner: str, size_bytes: int) -> None:
        """An owner keeps so many bytes now."""
        self._found[owner] = (time.monotonic(), size_bytes)

    def was_within(self, owner: str, most_bytes: int) -> bool:
        """An owner kept no more than that, at most `_LATELY_S` ago."""
        at, size_bytes = self._found.get(owner, (-math.inf, 0))
        return time.monotonic() - at < _LATELY_S and size_bytes <= most_bytes


def lock_key(session: Session, owner: str) -> Key | None:
    """The key of this owner, for whoever is about to record something of its own; see `service.catalog.keys.lock`.

    Raises `UnauthorizedError` for one that was revoked since its request began: nothing of a revoked key is new, so
    that all it has can be erased.
    """
    key = keys.lock(session, owner)
    if key is not None and key.revoked_at is not None:
        raise UnauthorizedError("this key was revoked meanwhile", invalid=True)
    return key


def check(
    session: Session,
    owner: str,
    *,
    now: datetime,
    jobs: int = 1,
    size_bytes: int = 0,
    uploads: int = 0,
    lock: bool = True,
    lately: Lately | None = None,
) -> None:
    """Raise `QuotaExceededError` when a key may not have so many more jobs, bytes or open uploads.

    Without keys only the uploads are counted. With ``lock``, raises what `lock_key` raises, too.

    With ``lock`` the key is kept from others until the transaction ends, before any medium is, so that two requests
    cannot both have the last of it; without, the answer is a first one, for what only reads. With ``lately``, bytes
    that nobody wants more of are not counted again for a moment, in which jobs of before may make some.
    """
    key = lock_key(session, owner) if lock else keys.get(session, owner)
    if uploads and resumable.count_open(session, owner, now=now) + uploads > MAX_OPEN_UPLOADS:
        detail = f"there may be {MAX_OPEN_UPLOADS} uploads that are not complete; complete some, or remove them"
        raise _exceeded("open-uploads", MAX_OPEN_UPLOADS, detail, _JOBS_RETRY_S)
    if key is None:
        return
    if jobs and amounts.active_jobs(session, owner) + jobs > key.active_jobs:
        detail = f"this key may have at most {key.active_jobs} unfinished job(s); wait for some, or cancel them"
        raise _exceeded("active-jobs", key.active_jobs, detail, _JOBS_RETRY_S)
    if size_bytes or lately is None or not lately.was_within(owner, key.stored_bytes):
        check_bytes(session, owner, key, size_bytes, now=now, lately=lately)


def check_bytes(
    session: Session,
    owner: str,
    key: Key | None,
    size_bytes: int,
    *,
    now: datetime,
    arriving: int = 0,
    lately: Lately | None = None,
) -> None:
    """Raise `QuotaExceededError` when so many bytes more are too many for an owner's key, if there is one.

    ``arriving`` are bytes that are on their way by other requests: where it is only with them too much, room may be
    soon, for they may not come whole, or be known already. What is found is noted in ``lately``.
    """
    if key is None:
        return
    stored = amounts.stored_bytes(session, owner)
    wanted = stored + size_bytes
    may = f"this key may keep {key.stored_bytes} bytes of media, assets and results"
    if wanted > key.stored_bytes:
        end = amounts.next_expiry(session, owner)
        wait_s = math.ceil((end - now).total_seconds()) if end is not None else _LONGEST_RETRY_S
        wait_s = min(max(1, wait_s), _LONGEST_RETRY_S)
        more = f", and {size_bytes} more are too many" if size_bytes else ""
        raise _exceeded("stored-bytes", key.stored_bytes, f"{may}; it keeps {stored}{more}; delete some", wait_s)
    if wanted + arriving > key.stored_bytes:
        detail = f"{may}, and {arriving} others are on their way; wait for them, or delete some"
        raise _exceeded("stored-bytes", key.stored_bytes, detail, _ARRIVING_RETRY_S)
    if lately is not None:
        lately.note(owner, wanted)


def left_bytes(session: Session, owner: str) -> int | None:
    """How many bytes more an owner may keep by what is recorded, below 0 for one that has too many; None for any."""
    key = keys.get(session, owner)
    return None if key is None else key.stored_bytes - amounts.stored_bytes(session, owner)


def _exceeded(policy: str, quota: int, detail: str, retry_s: int) -> QuotaExceededError:
    counted = _UNITS[policy]
    unit = ';qu="content-bytes"' if counted == "bytes" else ""
    return QuotaExceededError(
        detail,
        headers={
            "Retry-After": str(retry_s),
            "RateLimit-Policy": f'"{policy}";q={quota}{unit}',
            "RateLimit": f'"{policy}";r=0',
        },
        limit=Limit(quota, counted),
    )
