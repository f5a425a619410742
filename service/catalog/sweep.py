"""The reaper's queries and deletions: messages to send again, and records past their retention."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

from sqlalchemy import ColumnElement, delete, func, select
from sqlalchemy.orm import Session

from service.catalog import media, results
from service.catalog.database import changed
from service.catalog.jobs import Message
from service.catalog.models import ENDED, HELD, Job, JobState, Media, Result

#: rows that a sweep handles in one transaction
BATCH = 200


def unpublished(session: Session, *, before: datetime) -> list[Message]:
    """Queued jobs older than ``before`` for which no message was ever handed to the broker."""
    query = select(Job.id, Job.queue).where(*_queued(), Job.published_at.is_(None), Job.updated_at < before)
    return [Message(job_id, queue) for job_id, queue in session.execute(query.order_by(Job.id))]


def published(session: Session, queue: str, *, before: datetime) -> list[Message]:
    """Queued jobs whose message was handed to the broker before ``before``, oldest first."""
    query = select(Job.id).where(*_queued(), Job.queue == queue, Job.published_at < before).order_by(Job.id)
    return [Message(job_id, queue) for job_id in session.scalars(query)]


def queued_count(session: Session, queue: str) -> int:
    """How many jobs should have a message in this queue."""
    query = select(func.count()).select_from(Job)
    return session.scalar(query.where(*_queued(), Job.queue == queue, Job.published_at.is_not(None))) or 0


def _queued() -> list[ColumnElement[bool]]:
    return [Job.state == JobState.QUEUED, Job.waiting.is_(False)]


def expire_results(session: Session, *, now: datetime) -> list[str]:
    """Drop the bytes of results past their retention. Returns the blobs to delete after the commit."""
    late = select(Result).where(Result.expires_at < now, Result.blob_key.is_not(None)).limit(BATCH)
    keys = (results.drop_bytes(session, result) for result in session.scalars(late).all())
    return [key for key in keys if key]


def expire_media(session: Session, *, now: datetime) -> list[str]:
    """Delete media past their retention that no active job needs. Returns the blobs to delete after the commit."""
    late = select(Media).where(Media.expires_at < now).limit(BATCH).with_for_update()
    keys: list[str] = []
    for medium in session.scalars(late).all():
        if not media.active_jobs(session, medium.id):
            keys += media.delete(session, medium)
    return keys


def expire_jobs(session: Session, *, before: datetime) -> int:
    """Delete the records of jobs that ended before ``before`` and whose results are deleted. Returns their number."""
    kept = select(Result.job_id).where(Result.blob_key.is_not(None))
    vectorised = select(Media.job_id)
    old = [Job.state.in_(ENDED), Job.finished_at < before, Job.id.not_in(kept), Job.id.not_in(vectorised)]
    ids = session.scalars(select(Job.id).where(*old).limit(BATCH)).all()
    changed(session, delete(Result).where(Result.job_id.in_(ids)))
    return changed(session, delete(Job).where(Job.id.in_(ids)))


def held(session: Session, job_ids: Iterable[str]) -> set[str]:
    """Those of the jobs whose lease a worker holds."""
    return set(session.scalars(select(Job.id).where(Job.id.in_(list(job_ids)), Job.state.in_(HELD))))


def known_keys(session: Session, keys: Iterable[str]) -> set[str]:
    """Those of the keys that a record names."""
    wanted = list(keys)
    found: set[str] = set()
    for column in (Media.source_key, Media.asset_key, Result.blob_key):
        found.update(key for key in session.scalars(select(column).where(column.in_(wanted))) if key)
    return found
