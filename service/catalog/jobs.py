"""Jobs: recorded, listed, released when their media are ready, and brought to an end; `leases` has the worker's part.

Every change of a job is a step of the table in `service.catalog.transitions`, so a worker that comes late changes
nothing, and sees that it did not.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from types import MappingProxyType
from typing import Any, Final

from sqlalchemy import ColumnElement, and_, bindparam, exists, or_, select, union_all
from sqlalchemy.orm import Session

from service import tracing
from service.catalog import parts
from service.catalog.messages import QUEUE_OF, Message
from service.catalog.models import ENDED, Job, JobKind, JobState, Look, Media, MediaState, Result
from service.catalog.paging import newest
from service.catalog.requests import LookParams, Request, to_json
from service.catalog.transitions import JOB_TRANSITIONS, Lease, MediaStep, Step, take_media_step, take_step
from service.errors import of_medium, stored_problem
from service.ids import new_id

_EXPIRED = stored_problem("expired", "no worker took the job in time")

#: what clients ask for and see, not the shares of a job that is done in parts
OF_CLIENTS: Final = Job.parent_id.is_(None)


@dataclass(frozen=True)
class NewLook:
    """One output to make."""

    video_id: str
    reference_id: str
    params: LookParams


def get(session: Session, job_id: str, *, owner: str | None = None, lock: bool = False) -> Job | None:
    """The job, or None; with an ``owner``, who is a client, None for another's too.

    ``lock`` keeps it as it is until the transaction ends.
    """
    job = session.get(Job, job_id, with_for_update=True if lock else None)
    is_hidden = job is None or (owner is not None and (job.owner != owner or job.parent_id is not None))
    return None if is_hidden else job


def message_of(job: Job) -> Message:
    """The message that a job has, or would have."""
    return Message(job.id, job.queue)


def lock_looks(session: Session, *of: ColumnElement[bool]) -> None:
    """Keep others from the looks that fit.

    Whoever changes looks or removes results locks in one order, so that none waits for one that waits for him: a job
    before its looks, looks before their results, and several of a kind by their keys.
    """
    session.execute(select(Look.job_id).where(*of).order_by(Look.job_id, Look.position).with_for_update())


def looks(session: Session, job_id: str) -> list[Look]:
    """The job's outputs, in order."""
    return list(session.scalars(select(Look).where(Look.job_id == job_id).order_by(Look.position)))


def every(session: Session, job_ids: Collection[str]) -> list[Job]:
    """Those of the jobs that there are."""
    return list(session.scalars(select(Job).where(Job.id.in_(job_ids))))


@dataclass(frozen=True)
class Standing:
    """What of a job changes while it goes on, but for what is written with its end."""

    state: str
    attempt: int
    waiting: bool
    stage: str | None
    fraction: float
    frames_done: int
    frames_total: int

    @property
    def has_ended(self) -> bool:
        """True when nothing of it changes any more."""
        return self.state in ENDED

    @property
    def has_place(self) -> bool:
        """True while it waits for a worker alone, behind others."""
        return self.state == JobState.QUEUED and not self.waiting


_STANDING: Final = tuple(getattr(Job, one.name) for one in fields(Standing))


def standing_of(job: Job) -> Standing:
    """How a job stands."""
    return Standing(*(getattr(job, one.name) for one in fields(Standing)))


def standings(session: Session, job_ids: Collection[str]) -> dict[str, Standing]:
    """How each of the jobs stands, by one query that reads no more."""
    return {
        row[0]: Standing(*row[1:]) for row in session.execute(select(Job.id, *_STANDING).where(Job.id.in_(job_ids)))
    }


_LOOKS: Final = select(Look).where(Look.job_id.in_(bindparam("ids", expanding=True))).order_by(Look.position)


def looks_of(session: Session, job_ids: Collection[str]) -> dict[str, list[Look]]:
    """The outputs of each of the jobs, in order."""
    found: dict[str, list[Look]] = {}
    if job_ids:
        for look in session.scalars(_LOOKS, {"ids": job_ids}):
            found.setdefault(look.job_id, []).append(look)
    return found


@dataclass(frozen=True)
class Filter:
    """Which jobs to list; what is None or empty chooses nothing."""

    ids: Collection[str] | None = None
    #: the clip that is recoloured, or the medium that is vectorised
    video_id: str | None = None
    #: whose colours are used, or the medium that is vectorised
    reference_id: str | None = None
    states: Collection[str] = ()
    kinds: Collection[str] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)


def page(session: Session, owner: str, wanted: Filter, *, before: str | None, limit: int) -> list[Job]:
    """Jobs of an owner, newest first, older than the id ``before``; ids sort by creation."""
    chosen = [Job.owner == owner, OF_CLIENTS]
    if before is not None:
        chosen.append(Job.id < before)
    if wanted.ids is not None:
        chosen.append(Job.id.in_(wanted.ids))
    for column, media_id in ((Look.video_id, wanted.video_id), (Look.reference_id, wanted.reference_id)):
        if media_id is not None:
            of_it = select(Job.id).where(Job.media_id == media_id)
            chosen.append(Job.id.in_(union_all(of_it, select(Look.job_id).where(column == media_id))))
    if wanted.kinds:
        chosen.append(Job.kind.in_(wanted.kinds))
    chosen += [Job.metadata_[name].as_string() == value for name, value in wanted.metadata.items()]
    return newest(session, Job, chosen, wanted.states, limit=limit)


def fingerprint(kind: JobKind, request: Request, outputs: Sequence[NewLook], metadata: Mapping[str, str]) -> str:
    """The same for two requests of one owner that ask for the same, as 64 hex digits."""
    looks = [[look.video_id, look.reference_id, to_json(look.params)] for look in outputs]
    asked = [kind, to_json(request), looks, dict(metadata)]
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


_GONE: Final = (
    select(Look.job_id)
    .outerjoin(Result, Result.id == Look.result_id)
    .where(
        Look.job_id == Job.id,
        or_(
            Result.id.is_(None),
            Result.blob_key.is_(None),
            Result.expires_at <= bindparam("now", type_=Result.expires_at.type),
        ),
    )
)
_LIVES: Final = or_(
    Job.state.in_((JobState.QUEUED, JobState.RUNNING)), and_(Job.state == JobState.SUCCEEDED, ~exists(_GONE))
)
#: built once, as it is asked inside the transaction of every request: to build it takes longer than to run it
_SAME: Final = (
    select(Job)
    .where(Job.owner == bindparam("owner"), Job.fingerprint == bindparam("mark"), _LIVES)
    .order_by(Job.id.desc())
    .limit(1)
)


def find_same(session: Session, owner: str, fingerprint: str, *, now: datetime) -> Job | None:
    """The owner's newest job of this fingerprint that is going on, or whose results are all there still."""
    return session.scalar(_SAME, {"owner": owner, "mark": fingerprint, "now": now})


def create(
    session: Session,
    kind: JobKind,
    *,
    request: Request,
    now: datetime,
    media_id: str | None = None,
    outputs: Sequence[NewLook] = (),
    owner: str = "",
    metadata: Mapping[str, str] = MappingProxyType({}),
    ready: bool = False,
) -> Job:
    """Record a queued job.

    One that makes looks waits until `release` finds all its media ready, unless they are known to be: ``ready``.
    """
    waits = kind is not JobKind.VECTORIZE and not ready
    job = Job(
        id=new_id("job"),
        owner=owner,
        metadata_=dict(metadata),
        fingerprint=fingerprint(kind, request, outputs, metadata) if outputs else None,
        kind=kind,
        queue=QUEUE_OF[kind],
        state=JobState.QUEUED,
        waiting=waits,
        timings=_waited(now, now) if ready else None,
        media_id=media_id,
        request=to_json(request),
        traceparent=tracing.traceparent.get(),
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


_FAILS: Final = _needs(MediaState.FAILED)
_IS_READY: Final = and_(~_FAILS, ~_needs(MediaState.VECTORIZING))
#: the waiting jobs for which nothing is made any more: whether a medium of theirs has failed
_DECIDED: Final = (
    select(Job.id, Job.queue, Job.created_at, _FAILS.label("fails"))
    .where(Job.state == JobState.QUEUED, Job.waiting.is_(True), or_(_FAILS, _IS_READY))
    .order_by(Job.id)
)


def _waited(since: datetime, now: datetime) -> dict[str, float]:
    """How long a job has waited for its media, as its timings tell it."""
    return {"waited_s": round((now - since).total_seconds(), 3)}


def release(session: Session, *, now: datetime) -> list[Message]:
    """Release the waiting jobs whose media are all ready, and fail those with a failed medium.

    Returns the released jobs, to be published, in the order in which they were asked for. Run after a medium is done,
    and by the reaper. What another transaction has locked is left to it, or to the next time.
    """
    found = session.execute(_DECIDED).all()
    released: list[Message] = []
    for one in found:  # each step looks at the media once more: others may vectorise one again at the same time
        if not parts.lock_free(session, one.id):
            continue
        if one.fails:
            error = _media_error(session, one.id)
            if error is not None:
                end(session, Step.FAIL_WAITING, one.id, now=now, error=error, only_if=_FAILS)
            continue
        waited = _waited(one.created_at, now)
        if take_step(session, Step.RELEASE, one.id, now=now, only_if=_IS_READY, values={"timings": waited}):
            released.append(Message(one.id, one.queue))
    return released


def _media_error(session: Session, job_id: str) -> dict[str, Any] | None:
    """What a job fails with whose media have failed: the problem of the first of them, and where each stands.

    None when none of them has, any more.
    """
    job = session.get_one(Job, job_id)
    named = media_places(JobKind(job.kind), looks(session, job_id))
    query = select(Media.id, Media.error).where(Media.id.in_(named.values()), Media.state == MediaState.FAILED)
    failed = {row.id: of_medium(row.error, row.id) for row in session.execute(query) if row.error is not None}
    at = {place: failed[media_id] for place, media_id in named.items() if media_id in failed}
    if not at:
        return None
    errors = [{"pointer": place, "detail": str(error["detail"])} for place, error in at.items()]
    return {**next(iter(at.values())), "errors": errors}


def media_places(kind: JobKind, outputs: Sequence[Look]) -> dict[str, str]:
    """The media that a job was asked for, by where its JSON names them: a pointer (RFC 6901)."""
    video, first = outputs[0].video_id, outputs[0].reference_id
    if kind is JobKind.SWAP:
        return {"/a": video} | ({"/b": first} if first != video else {})
    return {"/video": video} | {f"{look_place(kind, look)}/reference": look.reference_id for look in outputs}


def look_place(kind: JobKind, look: Look) -> str:
    """Where the JSON of a job's request has the options of a look: those of a swap stand at its top."""
    return "" if kind is JobKind.SWAP else f"/looks/{look.position}"


def mark_published(session: Session, job_id: str, *, now: datetime) -> bool:
    """Remember when the job's message was handed to the broker. False when the job has ended by now."""
    return take_step(session, Step.PUBLISH, job_id, now=now, values={"published_at": now})


def cancel(session: Session, job_id: str, *, now: datetime) -> bool:
    """Ask for an end; False when the job is not queued or running, so that nothing was changed.

    A queued job ends at once; a running one is `canceling` until its worker or the reaper confirms.
    """
    # locked, or one that a worker gives back between the two steps would escape both
    get(session, job_id, lock=True)
    if end(session, Step.CANCEL_QUEUED, job_id, now=now, error=parts.CANCELED):
        return True
    if not take_step(session, Step.REQUEST_CANCEL, job_id, now=now):
        return False
    parts.cancel(session, job_id, now=now)
    return True


def revoke(session: Session, job_id: str, *, now: datetime) -> bool:
    """End an active job at once and take the lease away: its worker notices at the next step."""
    return end(session, Step.REVOKE, job_id, now=now, error=parts.CANCELED)


def expire(session: Session, *, before: datetime, now: datetime) -> int:
    """End the jobs that were last queued before ``before`` and are queued still. Returns their number.

    A part does not expire by itself: a job that is done in parts does, when for so long nobody has worked on any.
    """
    late = Job.queued_at < before
    ids = session.scalars(select(Job.id).where(Job.state == JobState.QUEUED, late, OF_CLIENTS)).all()
    ended = sum(
        end(session, Step.EXPIRE, job_id, now=now, error=_EXPIRED, only_if=late)
        for job_id in ids
        if parts.lock_free(session, job_id)
    )
    return ended + parts.expire(session, before=before, now=now, error=_EXPIRED)


def end(
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
    """An end other than success; the medium of a vectorising job fails with it, and the whole with one of its parts."""
    whole_id = parts.lock_whole(session, job_id)
    values = {"error": error, **values}
    if not take_step(session, step, job_id, now=now, lease=lease, only_if=only_if, values=values):
        return False
    take_media_step(session, MediaStep.FAIL, job_id, now=now, values={"error": error})
    if whole_id is None:
        parts.remove(session, job_id, now=now)
    elif JOB_TRANSITIONS[step].target is not JobState.FAILED or not parts.end_whole(
        session, Step.PARTS_FAILED, whole_id, now=now, values={"error": error}
    ):
        parts.stop_if_idle(session, whole_id, now=now)
    return True
