"""The state machines of jobs and media: which step leads from which state to which, and the UPDATE that takes it.

`JOB_TRANSITIONS` is the only description of a job's states, and `take_step` the only statement that changes one. A step
is one conditional UPDATE: of several processes that try steps at the same time, one changes the job, and the others see
that they changed nothing. docs/operations.md shows both tables as `as_markdown` prints them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import Enum, StrEnum
from types import MappingProxyType
from typing import Any, Final

from sqlalchemy import ColumnElement, update
from sqlalchemy.orm import Session

from service.catalog import ledger
from service.catalog.database import changed
from service.catalog.models import (
    ACTIVE,
    ENDED,
    HELD,
    Delivery,
    DeliveryState,
    Job,
    JobState,
    Media,
    MediaState,
)


@dataclass(frozen=True)
class Lease:
    """The right of one worker to change one job for a while."""

    job_id: str
    token: str


class LeaseCheck(Enum):
    """What a step asks of the job's lease."""

    NONE = "nothing"
    HELD = "the caller holds it"
    LAPSED = "its time is over"
    FREE = "nobody holds it"


class LeaseEffect(Enum):
    """What a step does to the job's lease."""

    NONE = "unchanged"
    GRANTED = "granted"
    PROLONGED = "prolonged"
    DROPPED = "taken away"


class Step(StrEnum):
    """A step of a job."""

    RELEASE = "release"
    FAIL_WAITING = "fail_waiting"
    PUBLISH = "publish"
    CANCEL_QUEUED = "cancel_queued"
    REQUEST_CANCEL = "request_cancel"
    REVOKE = "revoke"
    EXPIRE = "expire"
    REQUEUE = "requeue"
    GIVE_UP = "give_up"
    REAP_CANCELED = "reap_canceled"
    CLAIM = "claim"
    DEFER = "defer"
    RENEW = "renew"
    REPORT = "report"
    SUCCEED = "succeed"
    FAIL = "fail"
    CONFIRM_CANCEL = "confirm_cancel"
    GIVE_BACK = "give_back"
    WAIT_AGAIN = "wait_again"
    PUT_OFF = "put_off"
    SPLIT = "split"
    PARTS_REPORT = "parts_report"
    PARTS_JOINED = "parts_joined"
    PARTS_FAILED = "parts_failed"
    PARTS_STOPPED = "parts_stopped"
    PARTS_WAIT = "parts_wait"
    PARTS_AGAIN = "parts_again"
    PARTS_EXPIRED = "parts_expired"


@dataclass(frozen=True)
class Transition:
    """A row of the table of jobs.

    ``target`` is None where the state stays. ``waiting`` is what the step asks of the job's flag of that name; None
    asks nothing.
    """

    step: Step
    sources: tuple[JobState, ...]
    target: JobState | None
    meaning: str
    check: LeaseCheck = LeaseCheck.NONE
    effect: LeaseEffect = LeaseEffect.NONE
    waiting: bool | None = None


_S, _C, _E = JobState, LeaseCheck, LeaseEffect
_QUEUED, _RUNNING, _CANCELING = (_S.QUEUED,), (_S.RUNNING,), (_S.CANCELING,)

JOB_TRANSITIONS: Final = {
    row.step: row
    for row in (
        # steps of the API and the reaper
        Transition(Step.RELEASE, _QUEUED, _S.QUEUED, "the media it waits for are ready", waiting=True),
        Transition(Step.FAIL_WAITING, _QUEUED, _S.FAILED, "a medium it waits for has failed", waiting=True),
        Transition(Step.PUBLISH, ACTIVE, None, "its message is handed to the broker"),
        Transition(Step.CANCEL_QUEUED, _QUEUED, _S.CANCELED, "a client cancels it before a worker has it"),
        Transition(Step.REQUEST_CANCEL, _RUNNING, _S.CANCELING, "a client cancels it while a worker has it"),
        Transition(Step.REVOKE, ACTIVE, _S.CANCELED, "a medium it needs is deleted or sent again", _C.NONE, _E.DROPPED),
        Transition(Step.EXPIRE, _QUEUED, _S.EXPIRED, "no worker takes it in time"),
        Transition(Step.REQUEUE, _RUNNING, _S.QUEUED, "its worker no longer answers", _C.LAPSED, _E.DROPPED),
        Transition(Step.GIVE_UP, _RUNNING, _S.FAILED, "the same on the last attempt", _C.LAPSED, _E.DROPPED),
        Transition(Step.REAP_CANCELED, _CANCELING, _S.CANCELED, "its worker no longer answers", _C.LAPSED, _E.DROPPED),
        # steps of the worker
        Transition(Step.CLAIM, _QUEUED, _S.RUNNING, "a worker takes it", _C.NONE, _E.GRANTED, waiting=False),
        Transition(Step.DEFER, _QUEUED, None, "its message was used for another job: one is due again"),
        Transition(Step.RENEW, HELD, None, "its worker is alive", _C.HELD, _E.PROLONGED),
        Transition(Step.REPORT, HELD, None, "its worker reports progress", _C.HELD),
        Transition(Step.SUCCEED, _RUNNING, _S.SUCCEEDED, "its worker has done it", _C.HELD, _E.DROPPED),
        Transition(Step.FAIL, _RUNNING, _S.FAILED, "its worker cannot do it", _C.HELD, _E.DROPPED),
        Transition(Step.CONFIRM_CANCEL, _CANCELING, _S.CANCELED, "its worker has stopped", _C.HELD, _E.DROPPED),
        Transition(Step.GIVE_BACK, _RUNNING, _S.QUEUED, "its worker cannot go on", _C.HELD, _E.DROPPED),
        Transition(Step.WAIT_AGAIN, _RUNNING, _S.QUEUED, "an asset is made again", _C.HELD, _E.DROPPED),
        Transition(Step.PUT_OFF, _QUEUED, None, "its worker's disk has no room, or cannot be written", waiting=False),
        # of a job that is done in parts: it is running, and its parts have the leases
        Transition(Step.SPLIT, _RUNNING, None, "its worker has cut it into parts", _C.HELD, _E.DROPPED),
        Transition(Step.PARTS_REPORT, HELD, None, "a worker of a part reports progress", _C.FREE),
        Transition(Step.PARTS_JOINED, _RUNNING, _S.SUCCEEDED, "its parts are joined", _C.FREE),
        Transition(Step.PARTS_FAILED, _RUNNING, _S.FAILED, "one of its parts has failed", _C.FREE),
        Transition(Step.PARTS_STOPPED, _CANCELING, _S.CANCELED, "none of its parts goes on", _C.FREE),
        Transition(Step.PARTS_WAIT, _RUNNING, _S.QUEUED, "an asset of a part is made again", _C.FREE),
        Transition(Step.PARTS_AGAIN, _RUNNING, _S.QUEUED, "its join finds a part lost or damaged", _C.FREE),
        Transition(Step.PARTS_EXPIRED, _RUNNING, _S.EXPIRED, "no worker takes its parts in time", _C.FREE),
    )
}


def take_step(
    session: Session,
    step: Step,
    job_id: str,
    *,
    now: datetime,
    lease: Lease | None = None,
    lease_s: float | None = None,
    only_if: ColumnElement[bool] | None = None,
    values: Mapping[str, Any] = MappingProxyType({}),
) -> bool:
    """Take one step of one job, by one conditional UPDATE. True when the job was changed.

    ``lease`` is the one held (`LeaseCheck.HELD`), the one read before (`LeaseCheck.LAPSED`) or the one to grant;
    ``lease_s`` are the seconds it is granted or prolonged for. ``only_if`` is checked in the same statement, and
    ``values`` are written by it too.
    """
    row = JOB_TRANSITIONS[step]
    conditions = [Job.id == job_id, Job.state.in_(row.sources)]
    if row.waiting is not None:
        conditions.append(Job.waiting.is_(row.waiting))
    if row.check is LeaseCheck.FREE:
        conditions.append(Job.lease_token.is_(None))
    elif row.check is not LeaseCheck.NONE:
        assert lease is not None, f"{step} needs a lease"  # noqa: S101 - a mistake of the caller, not of the data
        conditions.append(Job.lease_token == lease.token)
    if row.check is LeaseCheck.LAPSED:
        conditions.append(Job.lease_expires_at < now)
    if only_if is not None:
        conditions.append(only_if)
    written = _of_state(row.target, now) | _of_lease(row.effect, now, lease, lease_s) | {"updated_at": now, **values}
    taken = bool(changed(session, update(Job).where(*conditions).values(**written)))
    if taken and row.target in ENDED:  # its webhooks are due, and it counts, from the very transaction that ends it
        ledger.count_job(session, job_id, row.target, now=now)
        waits = (Delivery.job_id == job_id, Delivery.state == DeliveryState.WAITING)
        changed(session, update(Delivery).where(*waits).values(state=DeliveryState.PENDING, next_at=now))
    return taken


def _of_state(target: JobState | None, now: datetime) -> dict[str, Any]:
    """What every way into a state writes."""
    if target is None:
        return {}
    # the progress is that of the present attempt
    progress = {"stage": None, "fraction": 0.0, "frames_done": 0, "frames_total": 0}
    if target is JobState.QUEUED:  # the time in the queue counts from here, and a message is due
        return {"state": target, "waiting": False, "queued_at": now, "published_at": None, **progress}
    if target is JobState.RUNNING:
        return {"state": target, "started_at": now, **progress}
    return {"state": target} | ({"waiting": False, "finished_at": now} if target in ENDED else {})


def _of_lease(effect: LeaseEffect, now: datetime, lease: Lease | None, lease_s: float | None) -> dict[str, Any]:
    if effect is LeaseEffect.NONE:
        return {}
    if effect is LeaseEffect.DROPPED:
        return {"lease_token": None, "lease_expires_at": None}
    assert lease is not None, "there is a lease to grant or prolong"  # noqa: S101 - a mistake of the caller
    assert lease_s is not None, "a lease has a length"  # noqa: S101
    expires = {"lease_expires_at": now + timedelta(seconds=lease_s)}
    return expires | ({"lease_token": lease.token} if effect is LeaseEffect.GRANTED else {})


class MediaStep(StrEnum):
    """A step of a medium."""

    FINISH = "finish"
    FAIL = "fail"
    VECTORIZE_AGAIN = "vectorize_again"
    MAKE_AGAIN = "make_again"


@dataclass(frozen=True)
class MediaTransition:
    """A row of the table of media."""

    step: MediaStep
    source: MediaState
    target: MediaState
    meaning: str


MEDIA_TRANSITIONS: Final = {
    row.step: row
    for row in (
        MediaTransition(MediaStep.FINISH, MediaState.VECTORIZING, MediaState.READY, "its job succeeded"),
        MediaTransition(MediaStep.FAIL, MediaState.VECTORIZING, MediaState.FAILED, "its job ended in any other way"),
        MediaTransition(
            MediaStep.VECTORIZE_AGAIN,
            MediaState.FAILED,
            MediaState.VECTORIZING,
            "the same bytes are uploaded again with the same settings",
        ),
        MediaTransition(
            MediaStep.MAKE_AGAIN,
            MediaState.READY,
            MediaState.VECTORIZING,
            "a job finds its asset lost, damaged or of another version",
        ),
    )
}


def take_media_step(
    session: Session, step: MediaStep, job_id: str, *, now: datetime, values: Mapping[str, Any]
) -> bool:
    """Take one step of the medium that ``job_id`` vectorises, by one conditional UPDATE. True when it was changed.

    ``values`` are written by the same statement.
    """
    row = MEDIA_TRANSITIONS[step]
    written = {"state": row.target, "updated_at": now, **values}
    where = (Media.job_id == job_id, Media.state == row.source)
    return bool(changed(session, update(Media).where(*where).values(**written)))


def as_markdown() -> str:
    """Both tables, as docs/operations.md shows them."""
    jobs = [
        (
            f"`{row.step}`",
            ", ".join(f"`{state}`" for state in row.sources) + _WAITING[row.waiting],
            f"`{row.target}`" if row.target else "unchanged",
            row.check.value,
            row.effect.value,
            row.meaning,
        )
        for row in JOB_TRANSITIONS.values()
    ]
    media = [(f"`{row.step}`", f"`{row.source}`", f"`{row.target}`", row.meaning) for row in MEDIA_TRANSITIONS.values()]
    return "\n\n".join(
        (
            _table(("step of a job", "from", "to", "asks of the lease", "the lease is", "when"), jobs),
            _table(("step of a medium", "from", "to", "when"), media),
        )
    )


_WAITING: Final = {None: "", True: ", waiting", False: ", not waiting"}


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    lines.insert(1, "|" + "---|" * len(head))
    return "\n".join(lines)
