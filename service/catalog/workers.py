"""The workers that are alive: each process says so now and then, what it does, and what keeps it from doing that."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Final, Literal

from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from service.catalog.database import changed
from service.catalog.models import Worker

#: records of workers that have been silent for so long are removed by the next one that speaks
_FORGOTTEN_S: Final = 3600.0


#: what a worker lacks whose broker is away: it can do jobs as soon as that is back
BROKER: Final = "broker"
#: what one lacks that cannot write on the disk of its own drafts
DISK: Final = "writable disk"

#: jobs: vectorises and renders; previews: makes single pictures while somebody waits
Kind = Literal["jobs", "previews"]


def beat(session: Session, worker_id: str, *, now: datetime, lacks: str | None = None, kind: Kind = "jobs") -> None:
    """A worker is alive. ``lacks`` says in a word or two why it can do no job."""
    changed(session, delete(Worker).where(Worker.seen_at < now - timedelta(seconds=_FORGOTTEN_S)))
    known = update(Worker).where(Worker.id == worker_id).values(seen_at=now, lacks=lacks)
    if not changed(session, known):
        session.add(Worker(id=worker_id, started_at=now, seen_at=now, lacks=lacks, kind=kind))


def leave(session: Session, worker_id: str) -> None:
    """A worker has stopped."""
    changed(session, delete(Worker).where(Worker.id == worker_id))


def heard_of(session: Session, *, since: datetime) -> int:
    """How many workers were seen since then. Asks for no column that tables of former versions lack."""
    return session.scalar(select(func.count()).where(Worker.seen_at >= since)) or 0


def lacking(session: Session, *, since: datetime, kind: Kind = "jobs") -> list[str | None]:
    """What each of the workers of a kind lacks that were seen since then: None for one that can work."""
    return list(session.scalars(select(Worker.lacks).where(Worker.seen_at >= since, Worker.kind == kind)))
