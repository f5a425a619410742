"""Jobs: recorded, claimed and done by workers, and brought to an end.

Every change of a job is a step of the table in `service.catalog.transitions`, so a worker that comes late changes
nothing, and sees that it did not.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from types import MappingProxyType
from typing import Any, Final

from sqlalchemy import ColumnElement, exists, or_, select
from sqlalchemy.orm import Session

from service.catalog.models import HELD, Job, JobKind, JobState, Look, Media, MediaState
from service.catalog.requests import LookParams, Request, to_json
from service.catalog.transitions import Lease, MediaStep, Step, take_media_step, take_step
from service.errors import stored_problem
from service.ids import new_id

#: the queue of each kind of job
QUEUE_OF: Final = {JobKind.VECTORIZE: "vectorize", JobKind.TRANSFER: "render", JobKind.SWAP: "render"}

_CANCELED = stored_problem("canceled", "the job was canceled")
_CRASHED = stored_problem("worker-crashed", "the worker stopped answering on every attempt")
_EXPIRED = stored_problem("expired", "no worker took the job in time")


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
    params: LookParams


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
    request: Request,
    now: datetime,
    media_id: str | None = None,
    outputs: Sequence[NewLook] = (),
) -> Job:
    """Record a queued job. It waits until `release` finds all its media ready."""
    job = Job(
        id=new_id("job"),
        kind=kind,
        queue=QUEUE_OF[kind],
        state=JobState.QUEUED,
        waiting=kind is not JobKind.VECTORIZE,
        attempt=1,
        media_id=media_id,
        request=to_json(request),
        fraction=0.0,
        frames_done=0,
        frames_total=0,
        created_at=now,
        updated_at=now,
        queued_at=now,
    )
    session.add(job)
    session.flush()
    session.add_all(
        Look(job_id=job.id, position=i, video_id=o.video_id, reference_id=o.reference_id, params=to_json(o.params))
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
    """Release the waiting jobs whose media are all ready, and fail those with a failed medium.

    Returns the released jobs, to be published. Run after a job is created, after a medium is done, and by the
    reaper: a job that was created while its medium became ready is seen by one of them.
    """
    waits = [Job.state == JobState.QUEUED, Job.waiting.is_(True)]
    if job_id is not None:
        waits.append(Job.id == job_id)
    for one in session.scalars(select(Job.id).where(*waits, _needs(MediaState.FAILED))).all():
        _end(session, Step.FAIL_WAITING, one, now=now, error=_media_error(session, one))
    free = session.execute(
        select(Job.id, Job.queue).where(*waits, ~_needs(MediaState.VECTORIZING), ~_needs(MediaState.FAILED))
    ).all()
    return [Message(one, queue) for one, queue in free if take_step(session, Step.RELEASE, one, now=now)]


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
    take_step(session, Step.PUBLISH, job_id, now=now, values={"published_at": now})


# the worker's steps


def claim(session: Session, job_id: str, *, now: datetime, lease_s: float) -> Lease | None:
    """Take a queued job for ``lease_s`` seconds. None when it is not available: taken, finished, waiting or unknown."""
    lease = Lease(job_id, secrets.token_hex(16))
    return lease if take_step(session, Step.CLAIM, job_id, now=now, lease=lease, lease_s=lease_s) else None


def renew(session: Session, lease: Lease, *, now: datetime, lease_s: float) -> bool:
    """Prolong a lease to ``lease_s`` seconds from now. False when it is lost."""
    return take_step(session, Step.RENEW, lease.job_id, now=now, lease=lease, lease_s=lease_s)


def held_state(session: Session, lease: Lease) -> JobState | None:
    """The state of a held job (running or canceling), or None when the lease is lost."""
    held = (Job.id == lease.job_id, Job.lease_token == lease.token, Job.state.in_(HELD))
    state = session.scalar(select(Job.state).where(*held))
    return JobState(state) if state is not None else None


def report(session: Session, lease: Lease, progress: Progress, *, now: datetime) -> bool:
    """Write the progress. False when the lease is lost."""
    values = {
        "stage": progress.stage,
        "fraction": progress.fraction,
        "frames_done": progress.frames_done,
        "frames_total": progress.frames_total,
    }
    return take_step(session, Step.REPORT, lease.job_id, now=now, lease=lease, values=values)


def succeed(session: Session, lease: Lease, *, now: datetime, timings: dict[str, Any]) -> bool:
    """End a running job well. False when the lease is lost or the job is being canceled: publish nothing then."""
    # reports are throttled, so the last one stopped short of the last frame
    values = {"fraction": 1.0, "frames_done": Job.frames_total, "timings": timings}
    return take_step(session, Step.SUCCEED, lease.job_id, now=now, lease=lease, values=values)


def fail(session: Session, lease: Lease, error: dict[str, Any], *, now: datetime, timings: dict[str, Any]) -> bool:
    """End a running job badly. False when the lease is lost or the job is being canceled."""
    return _end(session, Step.FAIL, lease.job_id, now=now, error=error, lease=lease, values={"timings": timings})


def confirm_cancel(session: Session, lease: Lease, *, now: datetime) -> bool:
    """The worker has stopped a job that was being canceled. False when the lease is lost."""
    return _end(session, Step.CONFIRM_CANCEL, lease.job_id, now=now, error=_CANCELED, lease=lease)


# the API's and the reaper's steps


def cancel(session: Session, job_id: str, *, now: datetime) -> bool:
    """Ask for an end; False when the job is not queued or running, so that nothing was changed.

    A queued job ends at once; a running one is `canceling` until its worker or the reaper confirms.
    """
    if _end(session, Step.CANCEL_QUEUED, job_id, now=now, error=_CANCELED):
        return True
    return take_step(session, Step.REQUEST_CANCEL, job_id, now=now)


def revoke(session: Session, job_id: str, *, now: datetime) -> bool:
    """End an active job at once and take the lease away: its worker notices at the next step."""
    return _end(session, Step.REVOKE, job_id, now=now, error=_CANCELED)


def reap(session: Session, *, now: datetime, max_attempts: int) -> list[Message]:
    """Deal with jobs whose worker went silent. Returns those queued again, to be published."""
    again: list[Message] = []
    lapsed = (Job.lease_expires_at < now, Job.state.in_(HELD))
    rows = session.execute(select(Job.id, Job.queue, Job.lease_token, Job.state, Job.attempt).where(*lapsed))
    for job_id, queue, token, state, attempt in rows.all():
        # each step checks the lease once more: a beat may have arrived in between
        lease = Lease(job_id, token or "")
        if state == JobState.CANCELING:
            _end(session, Step.REAP_CANCELED, job_id, now=now, error=_CANCELED, lease=lease)
        elif attempt >= max_attempts:
            _end(session, Step.GIVE_UP, job_id, now=now, error=_CRASHED, lease=lease)
        elif take_step(session, Step.REQUEUE, job_id, now=now, lease=lease, values={"attempt": Job.attempt + 1}):
            again.append(Message(job_id, queue))
    return again


def expire(session: Session, *, before: datetime, now: datetime) -> int:
    """End the jobs that were last queued before ``before`` and are queued still. Returns their number."""
    late = Job.queued_at < before
    ids = session.scalars(select(Job.id).where(Job.state == JobState.QUEUED, late)).all()
    return sum(_end(session, Step.EXPIRE, job_id, now=now, error=_EXPIRED, only_if=late) for job_id in ids)


def _end(
    session: Session,
    step: Step,
    job_id: str,
    *,
    now: datetime,
    error: dict[str, Any],
    lease: Lease | None = None,
    only_if: ColumnElement[bool] | None = None,
    values: Mapping[str, Any] = MappingProxyType({}),
) -> bool:
    """An end other than success; the medium of a vectorising job fails with it."""
    values = {"error": error, **values}
    if not take_step(session, step, job_id, now=now, lease=lease, only_if=only_if, values=values):
        return False
    take_media_step(session, MediaStep.FAIL, job_id, now=now, values={"error": error})
    return True
