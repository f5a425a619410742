"""Blobs that no record names, each with a row until its bytes are gone.

A blob has such a row from before its first byte is written. The transaction that records the blob removes the row, and
the one that removes the record writes it again, so whatever ends a process in between, the blob is known and goes.

What a worker writes for a job is due as soon as nobody holds the lease it had: the job was canceled, given to another
worker, or a medium of it deleted.
"""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import and_, delete, insert, or_, select, update
from sqlalchemy.orm import Session

from service.catalog.database import changed, in_batches
from service.catalog.models import HELD, Job, Tombstone
from service.catalog.transitions import Lease

#: seconds from a failed deletion to the next one, doubled each time
FIRST_WAIT_S: Final = 5.0
LONGEST_WAIT_S: Final = 3600.0
#: after the deletion of what a worker without a lease may still be writing, until it is deleted once more
WRITER_S: Final = 900.0


class LateError(Exception):
    """A blob was not recorded in time, and is deleted or will be."""


def expect(session: Session, key: str, *, now: datetime, within_s: float, lease: Lease | None = None) -> None:
    """A blob is about to be written; it goes unless it is recorded within so many seconds, and while the lease is held.

    ``lease`` is that of the job it is written for.
    """
    values = {
        "due_at": now + timedelta(seconds=within_s),
        "attempts": 0,
        "lease_token": None if lease is None else lease.token,
    }
    if not changed(session, update(Tombstone).where(Tombstone.blob_key == key).values(**values)):
        session.add(Tombstone(blob_key=key, created_at=now, **values))
        session.flush()


def hold(session: Session, key: str, *, now: datetime, within_s: float) -> None:
    """A blob is still being written: it goes unless it is recorded within so many seconds. One that was taken goes."""
    row = update(Tombstone).where(Tombstone.blob_key == key, Tombstone.attempts == 0, Tombstone.due_at > now)
    changed(session, row.values(due_at=now + timedelta(seconds=within_s)))


def bury(session: Session, keys: Collection[str], *, now: datetime) -> None:
    """Nothing names these blobs any more, from this transaction on: they are to be deleted."""
    values = {"due_at": now, "attempts": 0, "lease_token": None}
    for batch in in_batches(dict.fromkeys(keys)):
        known = _locked(session, batch)
        changed(session, update(Tombstone).where(Tombstone.blob_key.in_(known)).values(**values))
        if new := [{"blob_key": key, "created_at": now, **values} for key in batch if key not in known]:
            session.execute(insert(Tombstone), new)


def recorded(session: Session, keys: Collection[str]) -> bool:
    """This transaction records these blobs. False when one of them came too late and may be deleted: record none."""
    _locked(session, keys)
    # one that was taken is on its way
    kept = delete(Tombstone).where(Tombstone.blob_key.in_(keys), Tombstone.attempts == 0)
    return changed(session, kept) == len(set(keys))


def due(session: Session, *, now: datetime, limit: int) -> list[str]:
    """Blobs to delete now, the longest due first."""
    late = or_(Tombstone.due_at <= now, _IS_ABANDONED)
    query = select(Tombstone.blob_key).where(late).order_by(Tombstone.due_at).limit(limit)
    return list(session.scalars(query))


def awaited(session: Session, *, now: datetime) -> list[str]:
    """All blobs that are to be deleted, also those whose deletion has failed, or is made sure of once more, later."""
    late = or_(Tombstone.due_at <= now, Tombstone.attempts > 0, _IS_ABANDONED)
    return list(session.scalars(select(Tombstone.blob_key).where(late).order_by(Tombstone.blob_key)))


def written_for(session: Session, job_ids: Collection[str]) -> list[str]:
    """The blobs that workers are writing for these jobs and their parts."""
    keys: list[str] = []
    for batch in in_batches(job_ids):
        of_them = Job.id.in_(batch) | Job.parent_id.in_(batch)
        tokens = select(Job.lease_token).where(of_them, Job.lease_token.is_not(None))
        keys += session.scalars(select(Tombstone.blob_key).where(Tombstone.lease_token.in_(tokens)))
    return keys


def take(session: Session, keys: Collection[str], *, now: datetime) -> list[str]:
    """Take blobs that are due for deletion. Returns those that are still to be deleted.

    They are due again later, and later still each time, in case that their deletion fails.
    """
    taken = []
    for key in sorted(keys):  # as others lock several
        row = session.get(Tombstone, key, with_for_update=True)
        if row is None or (row.due_at > now and not _is_abandoned(session, key)):
            continue
        row.due_at = now + timedelta(seconds=min(FIRST_WAIT_S * 2**row.attempts, LONGEST_WAIT_S))
        row.attempts = min(row.attempts + 1, 20)
        taken.append(key)
    session.flush()
    return taken


def gone(session: Session, keys: Collection[str], *, now: datetime) -> None:
    """No byte of these blobs is left.

    Those that a worker may still be writing, since it has not seen that its lease is lost, are deleted once more later.
    """
    ended = Tombstone.blob_key.in_(_locked(session, keys))
    changed(session, delete(Tombstone).where(ended, Tombstone.lease_token.is_(None)))
    later = {"due_at": now + timedelta(seconds=WRITER_S), "lease_token": None}
    changed(session, update(Tombstone).where(ended).values(**later))


#: written under a lease that nobody holds any more, and not taken yet: a failed deletion waits like any other
_IS_ABANDONED: Final = and_(
    Tombstone.lease_token.is_not(None),
    Tombstone.attempts == 0,
    Tombstone.lease_token.not_in(select(Job.lease_token).where(Job.state.in_(HELD), Job.lease_token.is_not(None))),
)


def _locked(session: Session, keys: Collection[str]) -> set[str]:
    """Keep others from the rows of these blobs, in one order, so that none waits for one who waits for it.

    Returns those of the keys that have a row.
    """
    rows = select(Tombstone.blob_key).where(Tombstone.blob_key.in_(keys)).order_by(Tombstone.blob_key)
    return set(session.scalars(rows.with_for_update()))


def _is_abandoned(session: Session, key: str) -> bool:
    return session.scalar(select(Tombstone.blob_key).where(Tombstone.blob_key == key, _IS_ABANDONED)) is not None
