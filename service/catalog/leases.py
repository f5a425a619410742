"""Jobs in the hands of a worker: taken for a time, held, told of and brought to an end by who holds the lease.

Every step asks for the lease (`service.catalog.transitions`), so a worker that comes late changes nothing, and sees
that it did not. A lease that nobody renews lapses, and the job is another worker's.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from service.catalog import jobs, parts
from service.catalog.messages import Message
from service.catalog.models import HELD, Job, JobState
from service.catalog.transitions import Lease, Step, take_step
from service.errors import stored_problem

#: the stage of a queued job that a worker has no room for
NO_ROOM: Final = "waiting for room"

_CRASHED = stored_problem("worker-crashed", "the worker stopped answering on every attempt")


@dataclass(frozen=True)
class Progress:
    """How far a job is. ``fraction`` in [0, 1] covers the whole job, the frames only its present stage."""

    stage: str
    fraction: float
    frames_done: int
    frames_total: int


def new_token() -> str:
    """A token for a lease that nobody has yet."""
    return secrets.token_hex(16)


def claim(session: Session, job_id: str, *, now: datetime, lease_s: float, token: str | None = None) -> Lease | None:
    """Take a queued job for ``lease_s`` seconds. None when it is not available: taken, finished, waiting or unknown."""
    lease = Lease(job_id, token or new_token())
    return lease if take_step(session, Step.CLAIM, job_id, now=now, lease=lease, lease_s=lease_s) else None


def claimed(session: Session, token: str) -> Lease | None:
    """The lease of this token, if `claim` has granted it."""
    job_id = session.scalar(select(Job.id).where(Job.lease_token == token, Job.state.in_(HELD)))
    return Lease(job_id, token) if job_id is not None else None


def renew(session: Session, lease: Lease, *, now: datetime, lease_s: float) -> bool:
    """Prolong a lease to ``lease_s`` seconds from now. False when it is lost."""
    return take_step(session, Step.RENEW, lease.job_id, now=now, lease=lease, lease_s=lease_s)


def rewrite_one(session: Session) -> None:
    """Write a lease that somebody holds as it is: that fails on a full disk, as renewing it does.

    Without one, and of those that other transactions have locked, nothing is written.
    """
    held = select(Job.id).where(Job.state.in_(HELD)).limit(1).with_for_update(skip_locked=True)
    session.execute(update(Job).where(Job.id == held.scalar_subquery()).values(lease_expires_at=Job.lease_expires_at))


def held_state(session: Session, lease: Lease) -> JobState | None:
    """The state of a held job (running or canceling), or None when the lease is lost."""
    held = (Job.id == lease.job_id, Job.lease_token == lease.token, Job.state.in_(HELD))
    state = session.scalar(select(Job.state).where(*held))
    return JobState(state) if state is not None else None


def report(session: Session, lease: Lease, progress: Progress, *, now: datetime, whole_every_s: float = 0.0) -> bool:
    """Write the progress. False when the lease is lost.

    That of a part is told of the whole as well, at most every ``whole_every_s`` seconds for all parts together.
    """
    whole_id = parts.lock_to_tell(session, lease.job_id, now=now, every_s=whole_every_s)
    values = {
        "stage": progress.stage,
        "fraction": progress.fraction,
        "frames_done": progress.frames_done,
        "frames_total": progress.frames_total,
    }
    told = take_step(session, Step.REPORT, lease.job_id, now=now, lease=lease, values=values)
    if told and whole_id is not None:
        parts.tell(session, whole_id, now=now)
    return told


def succeed(session: Session, lease: Lease, *, now: datetime, timings: dict[str, Any]) -> bool:
    """End a running job well. False when the lease is lost or the job is being canceled: publish nothing then.

    What ends with a join is the job whose parts it has joined; its ``timings`` are those of the whole.
    """
    whole_id = parts.lock_whole(session, lease.job_id)
    if whole_id is not None and not parts.is_running(session, whole_id):
        return False
    # reports are throttled, so the last one stopped short of the last frame
    values = {"fraction": 1.0, "frames_done": Job.frames_total, "timings": timings}
    succeeded = take_step(session, Step.SUCCEED, lease.job_id, now=now, lease=lease, values=values)
    if succeeded and whole_id is not None:
        parts.end_whole(session, Step.PARTS_JOINED, whole_id, now=now, values=values)
    return succeeded


def fail(session: Session, lease: Lease, error: dict[str, Any], *, now: datetime, timings: dict[str, Any]) -> bool:
    """End a running job badly. False when the lease is lost or the job is being canceled."""
    return jobs.end(session, Step.FAIL, lease.job_id, now=now, error=error, lease=lease, values={"timings": timings})


def confirm_cancel(session: Session, lease: Lease, *, now: datetime) -> bool:
    """The worker has stopped a job that was being canceled. False when the lease is lost."""
    return jobs.end(session, Step.CONFIRM_CANCEL, lease.job_id, now=now, error=parts.CANCELED, lease=lease)


def put_off(session: Session, job_id: str, *, now: datetime, stage: str | None = NO_ROOM) -> bool:
    """Leave a queued job for later, at this ``stage``: `NO_ROOM` where there is none for it, None for no fault of it.

    Its message is used up and is sent again.
    """
    return take_step(session, Step.PUT_OFF, job_id, now=now, values={"stage": stage, "published_at": None})


def give_back(session: Session, lease: Lease, *, now: datetime, costs_attempt: bool = False) -> bool:
    """Return a running job to the queue, for another worker. False when the lease is lost or the job is being canceled.

    It is the worker that has to go, so the attempt does not count, unless ``costs_attempt``.
    """
    values = {"attempt": Job.attempt + 1} if costs_attempt else {}
    return take_step(session, Step.GIVE_BACK, lease.job_id, now=now, lease=lease, values=values)


def wait_again(session: Session, lease: Lease, *, now: datetime) -> bool:
    """Return a running job to those that wait for their media. False when the lease is lost.

    Of a part or a join, it is the whole job that waits, and begins anew.
    """
    whole_id = parts.lock_whole(session, lease.job_id)
    if whole_id is not None:
        held = held_state(session, lease) is JobState.RUNNING
        values = {"waiting": True, "attempt": 1}  # it showed the most of its parts
        return held and parts.end_whole(session, Step.PARTS_WAIT, whole_id, now=now, values=values)
    return take_step(session, Step.WAIT_AGAIN, lease.job_id, now=now, lease=lease, values={"waiting": True})


def draw_again(session: Session, lease: Lease, *, now: datetime, max_attempts: int) -> Message | None:
    """Have a whole job begin anew whose join finds a part lost or damaged; its message, to be published.

    None on its last attempt, when the lease is lost or the job is being canceled: nothing was changed.
    """
    whole_id = parts.lock_whole(session, lease.job_id)
    if whole_id is None or held_state(session, lease) is not JobState.RUNNING:
        return None
    whole = session.execute(select(Job.attempt, Job.queue).where(Job.id == whole_id)).one()
    if whole.attempt >= max_attempts:
        return None
    values = {"attempt": whole.attempt + 1}
    taken = parts.end_whole(session, Step.PARTS_AGAIN, whole_id, now=now, values=values)
    return Message(whole_id, whole.queue) if taken else None


def reap(session: Session, *, now: datetime, max_attempts: int) -> list[Message]:
    """Deal with jobs whose worker went silent. Returns those queued again, to be published.

    What another transaction has locked is left to the next time.
    """
    again: list[Message] = []
    lapsed = (Job.lease_expires_at < now, Job.state.in_(HELD))
    rows = session.execute(
        select(Job.id, Job.queue, Job.lease_token, Job.state, Job.attempt)
        .where(*lapsed)
        .order_by(func.coalesce(Job.parent_id, Job.id), Job.id)
    )
    for job_id, queue, token, state, attempt in rows.all():
        if not parts.lock_free(session, job_id):
            continue
        # each step checks the lease once more: a beat may have arrived in between
        lease = Lease(job_id, token or "")
        if state == JobState.CANCELING:
            jobs.end(session, Step.REAP_CANCELED, job_id, now=now, error=parts.CANCELED, lease=lease)
        elif attempt >= max_attempts:
            jobs.end(session, Step.GIVE_UP, job_id, now=now, error=_CRASHED, lease=lease)
        elif take_step(session, Step.REQUEUE, job_id, now=now, lease=lease, values={"attempt": Job.attempt + 1}):
            again.append(Message(job_id, queue))
    parts.end_abandoned(session, now=now)
    return again
