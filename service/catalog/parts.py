"""Jobs that are done in parts, by several workers at once.

A worker that takes a long render cuts it (`split`): the job stays running without a lease, and each part is a row of
`Job` of its own, claimed, leased, retried and canceled as any job. The transaction that ends the last part well adds
the join, which is one more such row, and whose success is that of the whole. When the whole ends, in any way, its parts
and their files go with it.

The row of the whole is locked before those of its parts, always: of two parts that end at the same moment the second
one sees that it is the last, and no two transactions wait for each other.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from types import MappingProxyType
from typing import Any, Final

from sqlalchemy import Exists, delete, exists, func, or_, select
from sqlalchemy.orm import Session, aliased

from service.catalog import tombstones
from service.catalog.database import changed, in_batches
from service.catalog.messages import QUEUE_OF, Message
from service.catalog.models import ACTIVE, HELD, Job, JobState, Look, Media, Part, PartFile, PartKind
from service.catalog.transitions import Lease, Step, take_step
from service.errors import stored_problem
from service.ids import new_id

_UNFINISHED: Final = stored_problem("internal-error", "a part of the job ended and left nothing; ask for it again")
CANCELED: Final = stored_problem("canceled", "the job was canceled")
#: the stages of the whole: parts are drawn, then joined, and how much of it the first are
DRAW, JOIN = "render", "join"
_DRAWN: Final = 0.97
#: of the jobs that are held, those that are done in parts
_IN_PARTS: Final = (Job.lease_token.is_(None), Job.parent_id.is_(None))


@dataclass(frozen=True)
class NewPart:
    """Frames [start, stop) of a video to draw."""

    video_id: str
    start: int
    stop: int


@dataclass(frozen=True)
class NewFile:
    """What was drawn of the look at this position of the job: its bytes are in the storage under ``key``."""

    position: int
    key: str
    size_bytes: int


def split(
    session: Session, lease: Lease, wanted: Sequence[NewPart], *, now: datetime, timings: Mapping[str, Any]
) -> list[Message] | None:
    """Cut a running job into parts and give its lease up. Returns the messages to publish.

    None when the lease is lost or the job is being canceled: nothing was changed.
    """
    frames = sum(part.stop - part.start for part in wanted)
    values = {"stage": DRAW, "fraction": 0.0, "frames_done": 0, "frames_total": frames, "timings": dict(timings)}
    if not take_step(session, Step.SPLIT, lease.job_id, now=now, lease=lease, values=values):
        # by a call before, whose answer was lost
        return messages(session, [lease.job_id]) or None
    whole = session.get_one(Job, lease.job_id)
    made_by = _vectorised_by(session, lease.job_id)
    made = []
    for number, part in enumerate(wanted):
        made.append(_add(session, PartKind.PART, whole, now=now))
        place = {"video_id": part.video_id, "start": part.start, "stop": part.stop}
        session.add(Part(id=made[-1].job_id, number=number, made_by=made_by, **place))
    session.flush()
    return made


def _vectorised_by(session: Session, job_id: str) -> dict[str, str]:
    """The job that vectorised each medium of a job's looks, by their ids."""
    mine = exists().where(Look.job_id == job_id, or_(Look.video_id == Media.id, Look.reference_id == Media.id))
    found = session.execute(select(Media.id, Media.job_id).where(mine))
    return dict(iter(found))


def made_by(session: Session, whole_id: str) -> Mapping[str, str]:
    """The jobs that had vectorised the media of a job, by their ids, as it was cut; empty where that is not known."""
    of_one = select(Part.made_by).join(Job, Job.id == Part.id).where(Job.parent_id == whole_id).limit(1)
    return session.scalar(of_one) or {}


def _add(session: Session, kind: PartKind, whole: Job, *, now: datetime) -> Message:
    job = Job(
        id=new_id("job"),
        owner=whole.owner,
        parent_id=whole.id,
        kind=kind,
        queue=QUEUE_OF[kind],
        state=JobState.QUEUED,
        waiting=False,
        request=whole.request,
        traceparent=whole.traceparent,
        created_at=now,
        updated_at=now,
        queued_at=now,
    )
    session.add(job)
    session.flush()
    return Message(job.id, job.queue)


def finish(
    session: Session, lease: Lease, files: Sequence[NewFile], *, now: datetime, timings: Mapping[str, Any]
) -> list[Message] | None:
    """End a part well. Returns what to publish: the join, when no part is left to do.

    None when the lease is lost or the job is being canceled, and nothing was changed. Raises `LateError` when a file
    took so long to be written that it is deleted.
    """
    whole_id = lock_whole(session, lease.job_id)
    values = {"fraction": 1.0, "frames_done": Job.frames_total, "timings": dict(timings)}
    if (
        whole_id is None
        or not is_running(session, whole_id)
        or not take_step(session, Step.SUCCEED, lease.job_id, now=now, lease=lease, values=values)
    ):
        return None
    if not tombstones.recorded(session, [file.key for file in files]):
        raise tombstones.LateError(lease.job_id)
    session.add_all(
        PartFile(part_id=lease.job_id, position=file.position, blob_key=file.key, size_bytes=file.size_bytes)
        for file in files
    )
    session.flush()
    tell(session, whole_id, now=now)
    if _active(session, whole_id):
        return []
    if not _all_drawn(session, whole_id):  # ended by a worker of another version, which knows no wholes
        end_whole(session, Step.PARTS_FAILED, whole_id, now=now, values={"error": _UNFINISHED})
        return []
    return [_add(session, PartKind.JOIN, session.get_one(Job, whole_id), now=now)]


def is_running(session: Session, whole_id: str) -> bool:
    """Whether a job, which is locked, goes on."""
    return session.scalar(select(Job.state).where(Job.id == whole_id)) == JobState.RUNNING


def _all_drawn(session: Session, whole_id: str) -> bool:
    lacking = exists().where(Job.parent_id == whole_id, Job.kind == PartKind.PART, Job.state != JobState.SUCCEEDED)
    return not session.scalar(select(lacking))


def is_finished(session: Session, part_id: str, files: Sequence[NewFile]) -> bool:
    """True when the part has ended with these files: `finish` has succeeded, though no answer said so."""
    kept = select(PartFile.blob_key).where(PartFile.part_id == part_id)
    return set(session.scalars(kept)) == {file.key for file in files}


def get(session: Session, part_id: str) -> Part | None:
    """What a part is to draw, or None."""
    return session.get(Part, part_id)


def whole_of(session: Session, job_id: str) -> str | None:
    """The job that this one is a share of; None for one that clients asked for, and for an unknown one."""
    return session.scalar(select(Job.parent_id).where(Job.id == job_id))


def lock_whole(session: Session, job_id: str) -> str | None:
    """The same, kept as it is by others until the transaction ends."""
    whole_id = whole_of(session, job_id)
    if whole_id is not None:
        session.execute(select(Job.id).where(Job.id == whole_id).with_for_update())
    return whole_id


def lock_to_tell(session: Session, job_id: str, *, now: datetime, every_s: float) -> str | None:
    """The same, but None also where the progress of the whole need not be told with that of this share of it.

    That of a part is told by a later report, while the whole was last changed less than ``every_s`` seconds ago.
    """
    whole = aliased(Job)
    shares = select(Job.kind, whole.id, whole.updated_at).join(whole, whole.id == Job.parent_id)
    share = session.execute(shares.where(Job.id == job_id)).one_or_none()
    if share is None or (share.kind == PartKind.PART and _is_near(share.updated_at, now, every_s)):
        return None
    locked = select(Job.updated_at).where(Job.id == share.id).with_for_update()
    updated_at = session.scalar(locked)
    # another part may have told it, or the whole have ended, meanwhile
    if updated_at is None or (share.kind == PartKind.PART and _is_near(updated_at, now, every_s)):
        return None
    return str(share.id)


def _is_near(time: datetime, now: datetime, seconds: float) -> bool:
    """On either side: of two parts one may come a little late, and a time far ahead is of a clock that was set back."""
    return abs(now - time) < timedelta(seconds=seconds)


def lock_free(session: Session, job_id: str) -> bool:
    """Lock a job, and first the one that it is a share of. False, at once, where another transaction has one of them.

    A machine that has lost its power keeps its rows until the server notices. That is no reason for others to wait.
    """
    ids = (whole_of(session, job_id), job_id)
    locks = (select(Job.id).where(Job.id == one).with_for_update(skip_locked=True) for one in ids if one is not None)
    return all(session.scalar(lock) is not None for lock in locks)


@dataclass(frozen=True)
class Drawn:
    """What the parts of a job have drawn, in the order of the parts."""

    video_id: str
    start: int
    stop: int
    #: the blobs, by the position of the look
    files: Mapping[int, str]
    timings: Mapping[str, Any]


def drawn(session: Session, whole_id: str) -> list[Drawn]:
    """What there is to join."""
    files: dict[str, dict[int, str]] = {}
    kept = select(PartFile).join(Job, Job.id == PartFile.part_id).where(Job.parent_id == whole_id)
    for file in session.scalars(kept):
        files.setdefault(file.part_id, {})[file.position] = file.blob_key
    done = select(Part, Job.timings).join(Job, Job.id == Part.id).where(Job.parent_id == whole_id).order_by(Part.number)
    return [
        Drawn(part.video_id, part.start, part.stop, files.get(part.id, {}), timings or {})
        for part, timings in session.execute(done)
    ]


def timings_of(session: Session, whole_id: str) -> dict[str, float]:
    """Seconds of a job, as they were when it was cut."""
    return dict(session.scalar(select(Job.timings).where(Job.id == whole_id)) or {})


def messages(session: Session, whole_ids: Collection[str]) -> list[Message]:
    """Of the parts of these jobs that wait for a worker."""
    query = select(Job.id, Job.queue).where(Job.state == JobState.QUEUED).order_by(Job.id)
    found = (session.execute(query.where(Job.parent_id.in_(batch))) for batch in in_batches(whole_ids))
    return [Message(*row) for rows in found for row in rows]


def files_of(session: Session, whole_ids: Collection[str]) -> list[str]:
    """The blobs that the parts of these jobs have drawn."""
    kept = select(PartFile.blob_key).join(Job, Job.id == PartFile.part_id)
    found = (session.scalars(kept.where(Job.parent_id.in_(batch))) for batch in in_batches(whole_ids))
    return [key for keys in found for key in keys]


def tell(session: Session, whole_id: str, *, now: datetime) -> None:
    """Show the progress of the parts as that of the whole, which never falls. The whole is locked."""
    length = Part.stop - Part.start
    sums = select(func.sum(length * Job.fraction), func.sum(length)).join(Job, Job.id == Part.id)
    done, frames = session.execute(sums.where(Job.parent_id == whole_id)).one()
    join = select(Job.fraction).where(Job.parent_id == whole_id, Job.kind == PartKind.JOIN)
    joined = session.scalar(join)
    attempt = session.scalar(select(func.max(Job.attempt)).where(Job.parent_id == whole_id)) or 1
    before = session.execute(select(Job.fraction, Job.frames_done, Job.attempt).where(Job.id == whole_id)).one()
    if not frames:
        return
    fraction = _DRAWN * done / frames + (1 - _DRAWN) * (joined or 0.0)
    values = {
        "stage": DRAW if joined is None else JOIN,
        "fraction": max(before.fraction, round(fraction, 4)),
        "frames_done": max(before.frames_done, int(done + 1e-6)),
        "frames_total": frames,
        "attempt": max(before.attempt, attempt),
    }
    take_step(session, Step.PARTS_REPORT, whole_id, now=now, values=values)


def cancel(session: Session, whole_id: str, *, now: datetime) -> None:
    """Stop the parts of a job that is being canceled: queued ones at once, others when their workers have stopped."""
    # locked, or one that a worker gives back between the two steps would escape both
    mine = select(Job.id).where(Job.parent_id == whole_id, Job.state.in_(ACTIVE)).order_by(Job.id).with_for_update()
    for part_id in session.scalars(mine).all():
        if not take_step(session, Step.CANCEL_QUEUED, part_id, now=now, values={"error": CANCELED}):
            take_step(session, Step.REQUEST_CANCEL, part_id, now=now)
    stop_if_idle(session, whole_id, now=now)


def stop_if_idle(session: Session, whole_id: str, *, now: datetime) -> None:
    """End a job that is being canceled when nobody works on it any more. The whole is locked."""
    if not _active(session, whole_id):
        end_whole(session, Step.PARTS_STOPPED, whole_id, now=now, values={"error": CANCELED})


def end_whole(
    session: Session,
    step: Step,
    whole_id: str,
    *,
    now: datetime,
    values: Mapping[str, Any] = MappingProxyType({}),
) -> bool:
    """Take a step of the whole that no part outlives. False when it was not taken."""
    if not take_step(session, step, whole_id, now=now, values=values):
        return False
    remove(session, whole_id, now=now)
    return True


def remove(session: Session, whole_id: str, *, now: datetime) -> None:
    """Forget the parts of a job; their files are to be deleted. A worker that has one finds its lease lost."""
    # in the order in which others lock them
    mine = select(Job.id).where(Job.parent_id == whole_id).order_by(Job.id).with_for_update()
    if not session.scalars(mine).all():
        return
    tombstones.bury(session, files_of(session, [whole_id]), now=now)
    changed(session, delete(Job).where(Job.parent_id == whole_id))


def expire(session: Session, *, before: datetime, now: datetime, error: dict[str, Any]) -> int:
    """End the jobs done in parts on none of which anybody has worked since ``before``. Returns their number."""
    late = (Job.updated_at < before, ~_has_part_in(HELD))
    ended = 0
    found = select(Job.id).where(Job.state == JobState.RUNNING, *_IN_PARTS, *late).order_by(Job.id)
    for whole_id in session.scalars(found).all():
        lock = select(Job.id).where(Job.id == whole_id, *late).with_for_update(skip_locked=True)
        if session.scalar(lock) is not None:
            ended += end_whole(session, Step.PARTS_EXPIRED, whole_id, now=now, values={"error": error})
    return ended


def end_abandoned(session: Session, *, now: datetime) -> None:
    """End the jobs done in parts of which no part is left to do, and that nobody has ended.

    No step leaves one so; a worker or reaper of another version, which knows no wholes, may.
    """
    abandoned = (Job.state.in_(HELD), *_IN_PARTS, ~_has_part_in(ACTIVE))
    for whole_id in session.scalars(select(Job.id).where(*abandoned).order_by(Job.id)).all():
        if not lock_free(session, whole_id) or _active(session, whole_id):
            continue
        if not end_whole(session, Step.PARTS_STOPPED, whole_id, now=now, values={"error": CANCELED}):
            end_whole(session, Step.PARTS_FAILED, whole_id, now=now, values={"error": _UNFINISHED})


def _has_part_in(states: Collection[JobState]) -> Exists:
    """Of the job of the outer query."""
    part = aliased(Job)
    return exists(select(part.id).where(part.parent_id == Job.id, part.state.in_(states)))


def _active(session: Session, whole_id: str) -> bool:
    return bool(session.scalar(select(exists().where(Job.parent_id == whole_id, Job.state.in_(ACTIVE)))))
