"""Figures of all jobs, workers and files, counted when they are asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import ColumnElement, delete, func, select, true
from sqlalchemy.orm import InstrumentedAttribute, Session

from service.catalog import collecting
from service.catalog.jobs import OF_CLIENTS
from service.catalog.models import (
    ACTIVE,
    ENDED,
    Delivery,
    DeliveryState,
    Job,
    JobKind,
    JobState,
    Media,
    Preview,
    PreviewState,
    RemovedJobs,
    Result,
    ResumableUpload,
    Tombstone,
    UploadPart,
    Worker,
)
from service.catalog.previews import KEPT_S

#: a request for a picture that is older was given up
_PREVIEW: Final = timedelta(seconds=KEPT_S)


@dataclass(frozen=True)
class Statistics:
    """What there is at one time."""

    #: active jobs by queue and state; "waiting" are queued ones whose media are not ready
    active: Mapping[tuple[str, str], int]
    #: shares of those that are done in parts, by state: waiting for a worker, or with one
    parts: Mapping[str, int]
    #: of the active jobs, how many are at a second attempt or a later one, by queue
    repeated: Mapping[str, int]
    #: seconds for which the first of those that wait for a worker has waited, by queue
    oldest_s: Mapping[str, float]
    #: jobs that have ended since the service began, by kind and state
    ended: Mapping[tuple[str, str], int]
    #: workers that are alive, by what they lack: "" for nothing
    workers: Mapping[str, int]
    #: workers of previews that are alive
    preview_workers: int
    #: bytes by what they are: source, asset, result, and what has arrived of files that come in pieces
    stored: Mapping[str, int]
    #: deliveries of webhooks by state; those whose job goes on are "waiting"
    deliveries: Mapping[str, int]
    #: files that have begun to arrive in pieces
    uploads: int
    #: single pictures that somebody waits for, by state
    previews: Mapping[str, int]
    #: blobs that are still to be deleted
    tombstones: int
    #: files without a record are kept
    is_halted: bool


def collect(session: Session, *, now: datetime, alive_since: datetime) -> Statistics:
    """Count. Workers that were seen since ``alive_since`` are alive."""
    active, repeated = _active(session)
    alive = select(Worker.kind, Worker.lacks, func.count()).where(Worker.seen_at >= alive_since)
    living = session.execute(alive.group_by(Worker.kind, Worker.lacks)).all()
    begun = (ResumableUpload.media_id.is_(None), ResumableUpload.size_bytes.is_not(None))
    arriving = select(func.count()).where(*begun, ResumableUpload.expires_at >= now)
    open_ = (Preview.state.in_((PreviewState.ASKED, PreviewState.TAKEN)), Preview.created_at > now - _PREVIEW)
    return Statistics(
        active=active,
        parts=_by_state(session, Job.state, Job.parent_id.is_not(None), Job.state.in_(ACTIVE)),
        repeated=repeated,
        oldest_s=_oldest_s(session, now),
        ended=_ended(session),
        workers={lacks or "": count for kind, lacks, count in living if kind == "jobs"},
        preview_workers=sum(count for kind, lacks, count in living if kind == "previews" and not lacks),
        stored=_stored(session),
        deliveries=_by_state(session, Delivery.state, Delivery.state != DeliveryState.DELIVERED),
        uploads=session.scalar(arriving) or 0,
        previews=_by_state(session, Preview.state, *open_),
        tombstones=session.scalar(select(func.count()).where(true()).select_from(Tombstone)) or 0,
        is_halted=collecting.halted(session) is not None,
    )


def _by_state(session: Session, state: InstrumentedAttribute[str], *those: ColumnElement[bool]) -> dict[str, int]:
    counted = select(state, func.count()).where(*those).group_by(state)
    return {str(name): count for name, count in session.execute(counted)}


def _active(session: Session) -> tuple[Counter[tuple[str, str]], Counter[str]]:
    """Unfinished jobs by queue and state, and by queue those of them that are tried again."""
    active: Counter[tuple[str, str]] = Counter()
    repeated: Counter[str] = Counter()
    # a labelled column is grouped by its name: PostgreSQL takes the same expression twice for two
    tried = (Job.attempt > 1).label("tried")
    by_state = select(Job.queue, Job.state, Job.waiting, tried, func.count()).where(Job.state.in_(ACTIVE), OF_CLIENTS)
    for queue, state, waiting, again, count in session.execute(
        by_state.group_by(Job.queue, Job.state, Job.waiting, tried)
    ):
        active[queue, "waiting" if waiting else state] += count
        repeated[queue] += count if again else 0
    return active, repeated


def _oldest_s(session: Session, now: datetime) -> dict[str, float]:
    """Since when the oldest job of each queue waits for a worker."""
    queued = (Job.state == JobState.QUEUED, Job.waiting.is_(False), OF_CLIENTS)
    waits = select(Job.queue, func.min(Job.queued_at)).where(*queued).group_by(Job.queue)
    return {queue: (now - since).total_seconds() for queue, since in session.execute(waits)}


def _ended(session: Session) -> Counter[tuple[str, str]]:
    """Jobs that have ended by kind and state, those too whose records are removed."""
    ended: Counter[tuple[str, str]] = Counter()
    over = (Job.kind.in_(tuple(JobKind)), Job.state.in_(ENDED), Job.finished_at.is_not(None), OF_CLIENTS)
    kept = select(Job.kind, Job.state, func.count()).where(*over).group_by(Job.kind, Job.state)
    removed = select(RemovedJobs.kind, RemovedJobs.state, RemovedJobs.count)
    for kind, state, count in (*session.execute(kept), *session.execute(removed)):
        ended[kind, state] += count
    return ended


def _stored(session: Session) -> dict[str, int]:
    """Bytes by what they are."""
    return {
        "source": session.scalar(select(func.sum(Media.size_bytes))) or 0,
        "asset": session.scalar(select(func.sum(Media.asset_bytes))) or 0,
        "result": session.scalar(select(func.sum(Result.size_bytes)).where(Result.blob_key.is_not(None))) or 0,
        "part": session.scalar(select(func.sum(UploadPart.size_bytes))) or 0,
    }


def remove_jobs(session: Session, job_ids: list[str]) -> int:
    """Delete the records of jobs that have ended, and keep their number. Returns it."""
    gone: Counter[tuple[str, str]] = Counter()
    deleted = delete(Job).where(Job.id.in_(job_ids)).returning(Job.kind, Job.state)
    for kind, state in session.execute(deleted, execution_options={"synchronize_session": False}):
        gone[kind, state] += 1
    for (kind, state), count in sorted(gone.items()):
        row = session.get(RemovedJobs, (kind, state), with_for_update=True)
        if row is None:
            row = RemovedJobs(kind=kind, state=state, count=0)
            session.add(row)
        row.count += count
    session.flush()
    return sum(gone.values())
