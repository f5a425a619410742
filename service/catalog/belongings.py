"""What belongs to an owner: how much there is of it, and each thing removed with all that tells of it.

Each removal is a transaction of its own, as short as what clients delete, and locks in the order in which they do. It
finds nothing to do where it was done before.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from datetime import datetime

from sqlalchemy import ColumnElement, delete, func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from service.catalog import jobs, media, resumable, sweep, tombstones
from service.catalog.database import changed
from service.catalog.messages import Message
from service.catalog.models import (
    ACTIVE,
    Base,
    Delivery,
    IdempotentRequest,
    Job,
    Media,
    Preview,
    Result,
    ResumableUpload,
    WebhookSecret,
)


@dataclass(frozen=True)
class Belongings:
    """How many things an owner has. Its counts of months are none of them, nor is its key."""

    media: int
    #: with the parts of results
    results: int
    #: with the shares of those that are done in parts
    jobs: int
    #: that arrive in pieces, or have become media
    uploads: int
    deliveries: int
    #: kept for an Idempotency-Key
    answers: int
    previews: int
    #: that webhooks are signed with: one, or none
    secrets: int

    def __bool__(self) -> bool:
        return any(astuple(self))


def count(session: Session, owner: str) -> Belongings:
    """What an owner has."""

    def rows(table: type[Base], *of: ColumnElement[bool]) -> int:
        return session.scalar(select(func.count()).select_from(table).where(*of)) or 0

    return Belongings(
        media=rows(Media, Media.owner == owner),
        results=rows(Result, Result.owner == owner),
        jobs=rows(Job, Job.owner == owner),
        uploads=rows(ResumableUpload, ResumableUpload.owner == owner),
        deliveries=rows(Delivery, Delivery.owner == owner),
        answers=rows(IdempotentRequest, IdempotentRequest.owner == owner),
        previews=rows(Preview, Preview.owner == owner),
        secrets=rows(WebhookSecret, WebhookSecret.owner == owner),
    )


def _some(session: Session, ids: InstrumentedAttribute[str], *of: ColumnElement[bool]) -> list[str]:
    return list(session.scalars(select(ids).where(*of).distinct().order_by(ids).limit(sweep.BATCH)))


def told_jobs(session: Session, owner: str) -> list[str]:
    """Ids of jobs of whose end somebody is to be told, or was; some of them."""
    return _some(session, Delivery.job_id, Delivery.owner == owner)


def remove_deliveries(session: Session, owner: str, job_id: str) -> None:
    """Tell nobody of a job's end: its deliveries go. The job is locked before them, as by whoever ends it."""
    jobs.get(session, job_id, lock=True)
    changed(session, delete(Delivery).where(Delivery.job_id == job_id, Delivery.owner == owner))


def media_ids(session: Session, owner: str) -> list[str]:
    """Ids of an owner's media; some of them."""
    return _some(session, Media.id, Media.owner == owner)


def remove_medium(session: Session, owner: str, media_id: str, *, now: datetime) -> list[Message]:
    """Delete a medium with everything made of it, and end the jobs that need it. Returns messages to take back."""
    media.lock_job(session, media_id, owner=owner)
    found = media.get(session, media_id, owner=owner, lock="update")
    if found is None:
        return []
    return sweep.delete_medium(session, found, media.active_jobs(session, media_id), now=now)[1]


def upload_ids(session: Session, owner: str) -> list[str]:
    """Ids of an owner's files that arrive in pieces; some of them."""
    return _some(session, ResumableUpload.id, ResumableUpload.owner == owner)


def remove_upload(session: Session, upload_id: str, *, now: datetime) -> None:
    """Remove a file that arrives in pieces, with what is there of it."""
    found = session.get(ResumableUpload, upload_id, with_for_update=True, populate_existing=True)
    if found is not None:
        resumable.remove(session, found, now=now)


def job_ids(session: Session, owner: str) -> list[str]:
    """Ids of the jobs that an owner has asked for; some of them."""
    return _some(session, Job.id, Job.owner == owner, jobs.OF_CLIENTS)


def remove_job(session: Session, owner: str, job_id: str, *, now: datetime) -> list[Message]:
    """End a job if it goes on, and delete its record, with its results. Returns messages to take back."""
    job = jobs.get(session, job_id, owner=owner, lock=True)
    if job is None:
        return []
    messages = sweep.revoke_jobs(session, [job_id], now=now)[1] if job.state in ACTIVE else []
    sweep.delete_job(session, job_id, now=now)
    return [jobs.message_of(job), *messages]  # of one that has ended a second message may be left


def remove_rest(session: Session, owner: str, *, now: datetime) -> None:
    """Remove what hangs on no medium and no job: pictures asked for, kept answers, the secret of webhooks."""
    pictures = select(Preview).where(Preview.owner == owner).order_by(Preview.id).with_for_update()
    for one in session.scalars(pictures).all():
        tombstones.bury(session, [one.blob_key] if one.blob_key else [], now=now)
    for table in (Preview, IdempotentRequest, WebhookSecret):
        changed(session, delete(table).where(table.owner == owner))
