"""The job state machine.

queued -> running -> succeeded | failed | canceled | expired, with `canceling` between running and canceled; a retry
goes back to queued with attempt + 1. Every step is one conditional UPDATE that names the states it starts from and,
for a worker, the lease it holds: a late worker changes nothing and is told so.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import ColumnElement, exists, or_, select, update
from sqlalchemy.orm import Session

from service.catalog.database import changed
from service.catalog.models import ACTIVE, HELD, Job, JobKind, JobState, Look, Media, MediaState
from service.ids import new_id

#: the queue of each kind of job
_QUEUE = {JobKind.VECTORIZE: "vectorize", JobKind.TRANSFER: "render", JobKind.SWAP: "render"}


@dataclass(frozen=True)
class Lease:
    """The right of one worker to change one job for a while."""

    job_id: str
    token: str


@dataclass(frozen=True)
class Message:
    """A job to publish, and its queue."""

    job_id: str
    queue: str


@dataclass(frozen=True)
class Progress:
    """How far a job is. ``fraction`` in [0, 1] covers the whole job, the frames only its present stage."""

    stage: str
    fraction: float
    frames_done: int
    frames_total: int


@dataclass(frozen=True)
class NewLook:
    """One output to make."""

    video_id: str
    reference_id: str
    params: dict[str, Any]


def get(session: Session, job_id: str) -> Job | None:
    """The job, or None."""
    return session.get(Job, job_id)


def looks(session: Session, job_id: str) -> list[Look]:
    """The job's outputs, in order."""
    return list(session.scalars(select(Look).where(Look.job_id == job_id).order_by(Look.position)))


def create(
    session: Session,
    kind: JobKind,
    *,
    request: dict[str, Any],
    now: datetime,
    media_id: str | None = None,
    outputs: Sequence[NewLook] = (),
) -> Job:
    """Record a queued job. It waits until `release` finds all its media ready."""
    job = Job(
        id=new_id("job"),
        kind=kind,
        queue=_QUEUE[kind],
        state=JobState.QUEUED,
        waiting=kind is not JobKind.VECTORIZE,
        attempt=1,
        media_id=media_id,
        request=request,
        fraction=0.0,
        frames_done=0,
        frames_total=0,
        created_at=now,
        updated_at=now,
    )
    session.add(job)
    session.flush()
    session.add_all(
        Look(job_id=job.id, position=i, video_id=o.video_id, reference_id=o.reference_id, params=o.params)
        for i, o in enumerate(outputs)
    )
    session.flush()
    return job


def _needs(state: MediaState) -> ColumnElement[bool]:
    """The job of the outer query needs a medium in this state."""
    return exists(
        select(Look.job_id)
        .join(Media, or_(Media.id == Look.video_id, Media.id == Look.reference_id))
        .where(Look.job_id == Job.id, Media.state == state)
    )


def release(session: Session, *, now: datetime, job_id: str | None = None) -> list[Message]:
    """Let the waiting jobs go whose media are all ready, and fail those with a failed medium.

    Returns the released jobs, to be published. Run after a job is created, after a medium is done, and by the
    reaper: a job that was created while its medium became ready is seen by one of them.
    """
    waits = [Job.state == JobState.QUEUED, Job.waiting.is_(True)]
    if job_id is not None:
        waits.append(Job.id == job_id)
    for one in session.scalars(select(Job.id).where(*waits, _needs(MediaState.FAILED))).all():
        _finish(session, one, waits, JobState.FAILED, now, error=_media_error(session, one))
    free = session.execute(
        select(Job.id, Job.queue).where(*waits, ~_needs(MediaState.VECTORIZING), ~_needs(MediaState.FAILED))
    ).all()
    return [
        Message(one, queue)
        for one, queue in free
        if changed(session, update(Job).where(Job.id == one, *waits).values(waiting=False, updated_at=now))
    ]


def _media_error(session: Session, job_id: str) -> dict[str, Any]:
    error = session.scalar(
        select(Media.error)
        .join(Look, or_(Media.id == Look.video_id, Media.id == Look.reference_id))
        .where(Look.job_id == job_id, Media.state == MediaState.FAILED)
        .order_by(Look.position)
        .limit(1)
    )
    assert error is not None, f"job {job_id} waits for a failed medium without an error"  # noqa: S101
    return dict(error)


def mark_published(session: Session, job_id: str, *, now: datetime) -> None:
    """Remember when the job's message was handed to the broker."""
    changed(session, update(Job).where(Job.id == job_id).values(published_at=now))


# the worker's steps


def claim(session: Session, job_id: str, *, now: datetime, lease_s: float) -> Lease | None:
    """Take a queued job. None when it is not to be had: taken, finished, waiting or unknown."""
    lease = Lease(job_id, secrets.token_hex(16))
    taken = changed(
        session,
        update(Job)
        .where(Job.id == job_id, Job.state == JobState.QUEUED, Job.waiting.is_(False))
        .values(
            state=JobState.RUNNING,
            lease_token=lease.token,
            lease_expires_at=now + timedelta(seconds=lease_s),
            started_at=now,
            updated_at=now,
            stage=None,
            fraction=0.0,
            frames_done=0,
            frames_total=0,
        ),
    )
    return lease if taken else None


def renew(session: Session, lease: Lease, *, now: datetime, lease_s: float) -> JobState | None:
    """Prolong a lease. Returns the job's state (running or canceling), or None when the lease is lost."""
    held = changed(session, update(Job).where(*_held(lease)).values(lease_expires_at=now + timedelta(seconds=lease_s)))
    if not held:
        return None
    state = session.scalar(select(Job.state).where(Job.id == lease.job_id))
    return JobState(state) if state is not None else None


def held_state(session: Session, lease: Lease) -> JobState | None:
    """The state of a held job (running or canceling), or None when the lease is lost."""
    state = session.scalar(select(Job.state).where(*_held(lease)))
    return JobState(state) if state is not None else None


def report(session: Session, lease: Lease, progress: Progress, *, now: datetime) -> bool:
    """Write the progress. False when the lease is lost."""
    values = {
        "stage": progress.stage,
        "fraction": progress.fraction,
        "frames_done": progress.frames_done,
        "frames_total": progress.frames_total,
        "updated_at": now,
    }
    return bool(changed(session, update(Job).where(*_held(lease)).values(values)))


def succeed(session: Session, lease: Lease, *, now: datetime, timings: dict[str, Any]) -> bool:
    """End a running job well. False when the lease is lost or the job is being canceled: publish nothing then."""
    where = [*_held(lease), Job.state == JobState.RUNNING]
    # reports are throttled, so the last one stopped short of the last frame
    whole = {"fraction": 1.0, "frames_done": Job.frames_total}
    return _finish(session, lease.job_id, where, JobState.SUCCEEDED, now, timings=timings, **whole)


def fail(session: Session, lease: Lease, error: dict[str, Any], *, now: datetime, timings: dict[str, Any]) -> bool:
    """End a running job badly. False when the lease is lost or the job is being canceled."""
    where = [*_held(lease), Job.state == JobState.RUNNING]
    return _finish(session, lease.job_id, where, JobState.FAILED, now, error=error, timings=timings)


def confirm_cancel(session: Session, lease: Lease, *, now: datetime) -> bool:
    """The worker has stopped a job that was being canceled."""
    where = [*_held(lease), Job.state == JobState.CANCELING]
    return _finish(session, lease.job_id, where, JobState.CANCELED, now, error=_CANCELED)


def _held(lease: Lease) -> list[ColumnElement[bool]]:
    return [Job.id == lease.job_id, Job.lease_token == lease.token, Job.state.in_(HELD)]


# the API's and the reaper's steps

_CANCELED = {"type": "canceled", "title": "The job was canceled", "detail": "the job was canceled"}
_CRASHED = {
    "type": "worker-crashed",
    "title": "The job crashed its worker repeatedly",
    "detail": "the worker stopped answering on every attempt",
}
_EXPIRED = {
    "type": "expired",
    "title": "The job waited too long in the queue",
    "detail": "no worker took the job in time",
}


def cancel(session: Session, job_id: str, *, now: datetime) -> bool:
    """Ask for an end; False when the job is not queued or running, so that nothing was changed.

    A queued job ends at once; a running one is `canceling` until its worker or the reaper confirms.
    """
    if _finish(session, job_id, [Job.state == JobState.QUEUED], JobState.CANCELED, now, error=_CANCELED):
        return True
    stop = update(Job).where(Job.id == job_id, Job.state == JobState.RUNNING)
    return bool(changed(session, stop.values(state=JobState.CANCELING, updated_at=now)))


def revoke(session: Session, job_id: str, *, now: datetime) -> bool:
    """End an active job at once and take the lease away: its worker notices at the next step."""
    return _finish(session, job_id, [Job.state.in_(ACTIVE)], JobState.CANCELED, now, error=_CANCELED)


def reap(session: Session, *, now: datetime, max_attempts: int) -> list[Message]:
    """Deal with jobs whose worker went silent. Returns those queued again, to be published."""
    lapsed = [Job.lease_expires_at < now, Job.state.in_(HELD)]
    again: list[Message] = []
    rows = session.execute(select(Job.id, Job.queue, Job.lease_token, Job.state, Job.attempt).where(*lapsed))
    for job_id, queue, token, state, attempt in rows.all():
        # the condition is checked again: a beat may have arrived in between
        where = [*lapsed, Job.lease_token == token, Job.state == state]
        if state == JobState.CANCELING:
            _finish(session, job_id, where, JobState.CANCELED, now, error=_CANCELED)
        elif attempt >= max_attempts:
            _finish(session, job_id, where, JobState.FAILED, now, error=_CRASHED)
        elif _requeue(session, [Job.id == job_id, *where], now):
            again.append(Message(job_id, queue))
    return again


def expire(session: Session, *, before: datetime, now: datetime) -> int:
    """End the jobs that have been queued since ``before``."""
    late = [Job.state == JobState.QUEUED, Job.created_at < before]
    ids = session.scalars(select(Job.id).where(*late)).all()
    return sum(_finish(session, job_id, late, JobState.EXPIRED, now, error=_EXPIRED) for job_id in ids)


def _requeue(session: Session, where: Sequence[ColumnElement[bool]], now: datetime) -> bool:
    values = {
        "state": JobState.QUEUED,
        "attempt": Job.attempt + 1,
        "lease_token": None,
        "lease_expires_at": None,
        "published_at": None,
        "updated_at": now,
    }
    return bool(changed(session, update(Job).where(*where).values(values)))


def _finish(
    session: Session,
    job_id: str,
    where: Sequence[ColumnElement[bool]],
    state: JobState,
    now: datetime,
    **values: Any,
) -> bool:
    """The one way into an end state; a vectorising job that does not succeed takes its medium along."""
    ended = changed(
        session,
        update(Job)
        .where(Job.id == job_id, *where)
        .values(
            state=state,
            waiting=False,
            lease_token=None,
            lease_expires_at=None,
            finished_at=now,
            updated_at=now,
            **values,
        ),
    )
    if not ended:
        return False
    if state is not JobState.SUCCEEDED:
        changed(
            session,
            update(Media)
            .where(Media.job_id == job_id, Media.state == MediaState.VECTORIZING)
            .values(state=MediaState.FAILED, error=values["error"], updated_at=now),
        )
    return True
