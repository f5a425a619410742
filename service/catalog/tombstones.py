"""Blobs that no record names, each with a row until its bytes are gone.

A blob has such a row from before its first byte is written. The transaction that records the blob removes the row, and
the one that removes the record writes it again, so whatever ends a process in between, the blob is known and goes.
"""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from service.catalog.database import changed
from service.catalog.models import Tombstone

#: seconds from a failed deletion to the next one, doubled each time
FIRST_WAIT_S: Final = 5.0
LONGEST_WAIT_S: Final = 3600.0
#: keys in one statement
_BATCH: Final = 500


class LateError(Exception):
    """A blob was not recorded in time, and is deleted or will be."""


def expect(session: Session, key: str, *, now: datetime, within_s: float) -> None:
    """A blob is about to be written; it goes unless it is recorded within so many seconds."""
    _write(session, key, now=now, due_at=now + timedelta(seconds=within_s))


def bury(session: Session, keys: Collection[str], *, now: datetime) -> None:
    """Nothing names these blobs any more, from this transaction on: they are to be deleted."""
    wanted = list(dict.fromkeys(keys))
    for start in range(0, len(wanted), _BATCH):
        batch = wanted[start : start + _BATCH]
        known = set(session.scalars(select(Tombstone.blob_key).where(Tombstone.blob_key.in_(batch)).with_for_update()))
        changed(session, update(Tombstone).where(Tombstone.blob_key.in_(known)).values(due_at=now, attempts=0))
        new = [key for key in batch if key not in known]
        session.add_all(Tombstone(blob_key=key, attempts=0, created_at=now, due_at=now) for key in new)
    session.flush()


def recorded(session: Session, keys: Collection[str]) -> bool:
    """This transaction records these blobs. False when one of them came too late and may be deleted: record none."""
    # one that was taken is on its way
    kept = delete(Tombstone).where(Tombstone.blob_key.in_(keys), Tombstone.attempts == 0)
    return changed(session, kept) == len(set(keys))


def due(session: Session, *, now: datetime, limit: int) -> list[str]:
    """Blobs to delete now, the longest due first."""
    query = select(Tombstone.blob_key).where(Tombstone.due_at <= now).order_by(Tombstone.due_at).limit(limit)
    return list(session.scalars(query))


def take(session: Session, keys: Collection[str], *, now: datetime) -> list[str]:
    """Take blobs that are due for deletion. Returns those that are still to be deleted.

    They are due again later, and later still each time, in case that their deletion fails.
    """
    taken = []
    for key in keys:
        row = session.get(Tombstone, key, with_for_update=True)
        if row is None or row.due_at > now:
            continue
        row.due_at = now + timedelta(seconds=min(FIRST_WAIT_S * 2**row.attempts, LONGEST_WAIT_S))
        row.attempts = min(row.attempts + 1, 20)
        taken.append(key)
    session.flush()
    return taken


def gone(session: Session, keys: Collection[str]) -> None:
    """No byte of these blobs is left."""
    changed(session, delete(Tombstone).where(Tombstone.blob_key.in_(keys)))


def _write(session: Session, key: str, *, now: datetime, due_at: datetime) -> None:
    if not changed(session, update(Tombstone).where(Tombstone.blob_key == key).values(due_at=due_at, attempts=0)):
        session.add(Tombstone(blob_key=key, attempts=0, created_at=now, due_at=due_at))
        session.flush()
