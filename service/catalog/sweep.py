"""The reaper's queries and deletions: messages to send again, and records past their retention."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime

from sqlalchemy import ColumnElement, delete, exists, select, union_all, update
from sqlalchemy.orm import Session

from service.catalog import idempotency, jobs, ledger, media, parts, results, resumable, statistics, tombstones
from service.catalog.database import changed
from service.catalog.messages import Message
from service.catalog.models import (
    ACTIVE,
    ENDED,
    HELD,
    Delivery,
    Job,
    JobKind,
    JobState,
    Look,
    Media,
    PartFile,
    Result,
    Tombstone,
    UploadPart,
)

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


def _queued() -> list[ColumnElement[bool]]:
    return [Job.state == JobState.QUEUED, Job.waiting.is_(False)]


def expire_results(session: Session, *, now: datetime) -> list[str]:
    """Drop the bytes of results past their retention. Returns the blobs to delete after the commit."""
    late = (Result.expires_at < now, Result.blob_key.is_not(None))
    # the first that went over, by the index of that
    first = session.scalars(select(Result.id).where(*late).order_by(Result.expires_at).limit(BATCH)).all()
    if not first:
        return []
    jobs.lock_looks(session, Look.result_id.in_(first))
    locked = select(Result).where(Result.id.in_(first), *late).order_by(Result.id).with_for_update()
    # one that is asked for again at this moment is late no more, or is seen to be gone
    found = session.scalars(locked).all()
    keys = (results.drop_bytes(session, result, now=now) for result in found)
    return [key for key in keys if key]


def late_media(session: Session, *, now: datetime) -> list[str]:
    """Ids of media past their retention that no active job needs."""
    of_looks = (select(column).join(Job, Job.id == Look.job_id) for column in (Look.video_id, Look.reference_id))
    of_jobs = select(Job.media_id).where(Job.media_id.is_not(None))
    needed = union_all(*(query.where(Job.state.in_(ACTIVE)) for query in (of_jobs, *of_looks)))
    # those that are needed must not keep the others waiting
    late = select(Media.id).where(Media.expires_at < now, Media.id.not_in(needed))
    return list(session.scalars(late.order_by(Media.expires_at).limit(BATCH)))


def expire_medium(session: Session, media_id: str, *, now: datetime) -> list[str]:
    """Delete a medium of `late_media`, unless it is needed again. Returns the blobs to delete after the commit."""
    media.lock_job(session, media_id)
    medium = media.get(session, media_id, lock="update")
    if medium is None or medium.expires_at >= now or media.active_jobs(session, media_id):
        return []
    return media.delete(session, medium, now=now, why="expired")


def expire_uploads(session: Session, *, now: datetime) -> int:
    """Remove unfinished uploads past their time. Returns their number."""
    return resumable.expire(session, now=now, limit=BATCH)


def expire_jobs(session: Session, *, before: datetime) -> int:
    """Delete the records of jobs that ended before ``before`` and whose results are deleted. Returns their number."""
    old = [
        jobs.OF_CLIENTS,
        Job.kind.in_(tuple(JobKind)),
        Job.state.in_(ENDED),
        Job.finished_at < before,
        ~exists().where(Result.job_id == Job.id, Result.blob_key.is_not(None)),
        ~exists().where(Media.job_id == Job.id),
    ]
    # as `delete_job`'s caller does, before their results: one that it has is its own
    locked = select(Job.id).where(*old).limit(BATCH).with_for_update(skip_locked=True)
    ids = session.scalars(locked).all()
    jobs.lock_looks(session, Look.job_id.in_(ids))
    changed(session, delete(Result).where(Result.job_id.in_(ids)))
    return statistics.remove_jobs(session, list(ids))


def expire_months(session: Session, *, now: datetime, keep_months: int) -> int:
    """Remove the counts of months past their retention, as the last step of a transaction. Returns their number."""
    return ledger.expire(session, now=now, keep_months=keep_months, limit=BATCH)


def delete_medium(
    session: Session, medium: Media, active: Sequence[str], *, now: datetime
) -> tuple[list[str], list[Message]]:
    """Delete a medium with everything derived from it, and end its unfinished jobs, which are ``active``.

    Returns the blobs to delete, and the messages to take back, after the commit.
    """
    drawn, ended = revoke_jobs(session, active, now=now)
    return media.delete(session, medium, now=now) + drawn, ended


def revoke_jobs(session: Session, active: Sequence[str], *, now: datetime) -> tuple[list[str], list[Message]]:
    """End unfinished jobs at once. Returns what their workers have drawn and are writing, and messages, as above."""
    ended, drawn = parts.messages(session, active), parts.files_of(session, active)
    drawn += tombstones.written_for(session, active)
    for job_id in active:
        jobs.revoke(session, job_id, now=now)
    ended += [jobs.message_of(job) for job_id in active if (job := jobs.get(session, job_id))]
    return drawn, ended


def delete_job(session: Session, job_id: str, *, now: datetime) -> list[str]:
    """Delete the record of a job that has ended, with its results and what tells of it: deliveries and kept answers.

    Returns the blobs to delete after the commit, whose tombstones are written. What ended jobs are counted by stays.
    """
    jobs.lock_looks(session, Look.job_id == job_id)
    changed(session, update(Look).where(Look.job_id == job_id).values(result_id=None, result_gone="deleted"))
    of_job = Result.job_id == job_id
    found = session.execute(
        select(Result.id, Result.blob_key).where(of_job).order_by(Result.id).with_for_update()
    ).all()
    told = select(Delivery.id).where(Delivery.job_id == job_id)
    for ids in ([job_id, *(row.id for row in found)], told):
        idempotency.forget(session, ids)
    changed(session, delete(Result).where(of_job))
    statistics.remove_jobs(session, [job_id])
    keys = [row.blob_key for row in found if row.blob_key]
    tombstones.bury(session, keys, now=now)
    return keys


def held(session: Session, job_ids: Iterable[str]) -> set[str]:
    """Those of the jobs whose lease a worker holds."""
    return set(session.scalars(select(Job.id).where(Job.id.in_(list(job_ids)), Job.state.in_(HELD))))


def known_keys(session: Session, keys: Iterable[str]) -> set[str]:
    """Those of the keys that a record or a tombstone names."""
    wanted = list(keys)
    columns = (
        *(Media.source_key, Media.asset_key, Media.pictures_key),
        *(Result.blob_key, PartFile.blob_key, UploadPart.blob_key, Tombstone.blob_key),
    )
    # one statement sees one state: a key that moves from its tombstone to a record is never in between
    return set(session.scalars(union_all(*(select(column).where(column.in_(wanted)) for column in columns))))
