"""Figures of all jobs, workers and files, counted when they are asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import delete, func, select, true
from sqlalchemy.orm import Session

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
    queued = (Job.state == JobState.QUEUED, Job.waiting.is_(False), OF_CLIENTS)
    waits = select(Job.queue, func.min(Job.queued_at)).where(*queued)
    shares = select(Job.state, func.count()).where(Job.parent_id.is_not(None), Job.state.in_(ACTIVE))
    oldest = {queue: (now - since).total_seconds() for queue, since in session.execute(waits.group_by(Job.queue))}
    ended: Counter[tuple[str, str]] = Counter()
    over = (Job.kind.in_(tuple(JobKind)), Job.state.in_(ENDED), Job.finished_at.is_not(None), OF_CLIENTS)
    kept = select(Job.kind, Job.state, func.count()).where(*over).group_by(Job.kind, Job.state)
    removed = select(RemovedJobs.kind, RemovedJobs.state, RemovedJobs.count)
    for kind, state, count in (*session.execute(kept), *session.execute(removed)):
        ended[kind, state] += count
    alive = select(Worker.kind, Worker.lacks, func.count()).where(Worker.seen_at >= alive_since)
    living = session.execute(alive.group_by(Worker.kind, Worker.lacks)).all()
    told = select(Delivery.state, func.count()).where(Delivery.state != DeliveryState.DELIVERED)
    begun = (ResumableUpload.media_id.is_(None), ResumableUpload.size_bytes.is_not(None))
    arriving = select(func.count()).where(*begun, ResumableUpload.expires_at >= now)
    open_ = (Preview.state.in_((PreviewState.ASKED, PreviewState.TAKEN)), Preview.created_at > now - _PREVIEW)
    drawn = select(Preview.state, func.count()).where(*open_)
    return Statistics(
        active=active,
        parts={str(state): count for state, count in session.execute(shares.group_by(Job.state))},
        repeated=repeated,
        oldest_s=oldest,
        ended=ended,
        workers={lacks or "": count for kind, lacks, count in living if kind == "jobs"},
        preview_workers=sum(count for kind, lacks, count in living if kind == "previews" and not lacks),
        stored={
            "source": session.scalar(select(func.sum(Media.size_bytes))) or 0,
            "asset": session.scalar(select(func.sum(Media.asset_bytes))) or 0,
            "result": session.scalar(select(func.sum(Result.size_bytes)).where(Result.blob_key.is_not(None))) or 0,
            "part": session.scalar(select(func.sum(UploadPart.size_bytes))) or 0,
        },
        deliveries={str(state): count for state, count in session.execute(told.group_by(Delivery.state))},
        uploads=session.scalar(arriving) or 0,
        previews={str(state): count for state, count in session.execute(drawn.group_by(Preview.state))},
        tombstones=session.scalar(select(func.count()).where(true()).select_from(Tombstone)) or 0,
        is_halted=collecting.halted(session) is not None,
    )


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
