"""What is likely of jobs that have not ended: their place in the queue, and when they will be done.

Measured, not modelled: how long recent jobs of the same kind took for each unit of their work, what a running job has
done already, and what stands before a queued one, for as many workers as are alive. A unit of rendering is a pixel of
a frame of a look; of vectorising it is a byte of the file, since its frames are known only afterwards. Where nothing
like a job has been measured nothing is said of it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Final

from sqlalchemy import ColumnElement, and_, bindparam, func, or_, select
from sqlalchemy.orm import Session

from service.catalog.models import HELD, Job, JobKind, JobState, Look, Media, Worker

#: recent jobs of a kind that are measured, and how few of them say something
_MEASURED: Final = 40
_FEWEST: Final = 3
#: the tenth, the half and the ninth of ten of what is seen
_LOW, _MIDDLE, _HIGH = 0.1, 0.5, 0.9
#: standard deviations between the middle and the ninth of ten, for a sum of many
_SPREAD: Final = 1.28
#: the fraction of a job from which its own pace says something, and how far that may be off at both sides
_OWN_PACE: Final = 0.1
_OWN_SPREAD: Final = 1.6


@dataclass(frozen=True)
class Estimate:
    """Seconds: the middle of what is likely, and a span that four in five jobs should end in."""

    seconds: float
    low: float
    high: float


@dataclass(frozen=True)
class Forecast:
    """What is known of a job: its place among those that wait for a worker, from 1, and the time until it is done."""

    position: int | None = None
    eta: Estimate | None = None


@dataclass(frozen=True)
class History:
    """What recent jobs took: seconds for a unit of work by what they did, and seconds of whole jobs by queue."""

    paces: Mapping[str, Sequence[float]] = field(default_factory=dict)
    durations: Mapping[str, Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Load:
    """What the workers have to do: how many they are, seconds that their jobs still take, and who waits where."""

    slots: int
    running: int
    remaining_s: float
    #: by queue, then by owner: how many wait, and since when the first of them
    queued: Mapping[str, Mapping[str, tuple[int, datetime]]]


def history(session: Session) -> History:
    """What the newest succeeded jobs of each kind took, by three queries a kind."""
    paces: defaultdict[str, list[float]] = defaultdict(list)
    durations: defaultdict[str, list[float]] = defaultdict(list)
    for kind in JobKind:
        done = (Job.kind == kind, Job.state == JobState.SUCCEEDED, Job.parent_id.is_(None))
        timed = (Job.started_at.is_not(None), Job.finished_at.is_not(None))
        recent = select(Job).where(*done, *timed).order_by(Job.finished_at.desc())
        found = list(session.scalars(recent.limit(_MEASURED)))
        works = _works(session, found)
        for job in found:
            if job.started_at is None or job.finished_at is None:
                continue
            seconds = max(0.001, (job.finished_at - job.started_at).total_seconds())
            durations[job.queue].append(seconds)
            if work := works.get(job.id):
                paces[_deed(job)].append(seconds / work)
    return History({deed: sorted(of_one) for deed, of_one in paces.items()}, durations)


def forecasts(
    session: Session, found: Collection[Job], measured: History, *, alive_since: datetime
) -> dict[str, Forecast]:
    """What is likely of each of these jobs that is queued for a worker or running; none of the others.

    Workers that were seen since ``alive_since`` count. Its queries are as many for two hundred jobs as for one.
    """
    told = [job for job in found if job.state == JobState.RUNNING or _waits_for_a_worker(job)]
    if not told:
        return {}
    queued = [job for job in told if job.state == JobState.QUEUED]
    # running jobs are asked for the most often, and depend on nobody else
    load = _load(session, measured, alive_since=alive_since) if queued else None
    places = _places(session, queued) if queued else {}
    works = _works(session, told)
    answers = {}
    for job in told:
        own = usual(_deed(job), works.get(job.id), measured)
        if job.state == JobState.RUNNING:
            answers[job.id] = Forecast(eta=_remaining(job, own))
            continue
        before = places.get(job.id)
        if before is None or load is None:  # it was taken in between
            continue
        position = 1 + before + _of_others(load, job, before)
        answers[job.id] = Forecast(position, until_done(load, measured, job.queue, position - 1, own))
    return answers


def until_done(load: Load, measured: History, queue: str, before: int, own: Estimate | None) -> Estimate | None:
    """When a queued job will be done that has so many before it and takes ``own`` by itself; None when nobody knows."""
    wait = _wait(load, measured, queue, before)
    return None if own is None or wait is None else _after(wait, own)


def _waits_for_a_worker(job: Job) -> bool:
    return job.state == JobState.QUEUED and not job.waiting


def _deed(job: Job) -> str:
    """What jobs of the same pace do: references are read otherwise than videos."""
    return f"vectorize {job.request.get('role')}" if job.kind == JobKind.VECTORIZE else "render"


def _works(session: Session, found: Sequence[Job]) -> dict[str, float]:
    """The units of work of jobs, by id, as far as they are known."""
    sizes = {job.media_id: job.id for job in found if job.kind == JobKind.VECTORIZE and job.media_id}
    works: defaultdict[str, float] = defaultdict(float)
    files = select(Media.id, Media.size_bytes).where(Media.id.in_(sizes))
    for media_id, size_bytes in session.execute(files) if sizes else ():
        works[sizes[media_id]] = float(size_bytes)
    drawn = [job.id for job in found if job.kind != JobKind.VECTORIZE]
    for job_id, info in session.execute(_DRAWN, {"ids": drawn}) if drawn else ():
        size = info or {}
        works[job_id] += max(1, size.get("frame_count", 0)) * size.get("width", 0) * size.get("height", 0)
    return works


def _load(session: Session, measured: History, *, alive_since: datetime) -> Load:
    slots = session.scalar(_ALIVE, {"since": alive_since}) or 0
    remaining = 0.0
    held = session.scalars(_AT_WORK).all()
    for job in held:
        whole = _mean(measured.durations.get(job.queue, ()))
        own = None if whole is None else Estimate(whole, whole, whole)
        left = _remaining(job, own)
        remaining += left.seconds if left is not None else 0.0
    queued: defaultdict[str, dict[str, tuple[int, datetime]]] = defaultdict(dict)
    for queue, owner, count, since in session.execute(_WAITING):
        queued[queue][owner] = (count, since)
    return Load(slots, len(held), remaining, queued)


def _available() -> tuple[ColumnElement[bool], ...]:
    # a job that is done in parts counts as the one job it is
    return Job.state == JobState.QUEUED, Job.waiting.is_(False), Job.parent_id.is_(None)


# of every answer that shows a queued job, inside the transaction that makes it: to build them takes as long as to run
# them, so that they are built once
_ALIVE: Final = select(func.count()).where(
    Worker.seen_at >= bindparam("since", type_=Worker.seen_at.type), Worker.lacks.is_(None), Worker.kind == "jobs"
)
_AT_WORK: Final = select(Job).where(Job.state.in_(HELD), Job.parent_id.is_(None))
_WAITING: Final = (
    select(Job.queue, Job.owner, func.count(), func.min(Job.queued_at))
    .where(*_available())
    .group_by(Job.queue, Job.owner)
)
_SINCE: Final = bindparam("since", type_=Job.queued_at.type)
_BEFORE: Final = select(func.count()).where(
    *(Job.queue == bindparam("queue"), Job.owner == bindparam("owner"), *_available()),
    or_(Job.queued_at < _SINCE, and_(Job.queued_at == _SINCE, Job.id < bindparam("id"))),
)
_DRAWN: Final = (
    select(Look.job_id, Media.info)
    .join(Media, Media.id == Look.video_id)
    .where(Look.job_id.in_(bindparam("ids", expanding=True)))
)


def _places(session: Session, queued: Sequence[Job]) -> dict[str, int]:
    """How many of the same owner's jobs stand before each of these in their queues."""
    if len(queued) == 1:
        (job,) = queued
        of_it = {"queue": job.queue, "owner": job.owner, "since": job.queued_at, "id": job.id}
        return {job.id: session.scalar(_BEFORE, of_it) or 0}
    places: dict[str, int] = {}
    for queue, owner in {(job.queue, job.owner) for job in queued}:
        ids = select(Job.id).where(Job.queue == queue, Job.owner == owner, *_available())
        places |= {job_id: k for k, job_id in enumerate(session.scalars(ids.order_by(Job.queued_at, Job.id)))}
    return places


def _of_others(load: Load, job: Job, before: int) -> int:
    """How many jobs of other owners are likely to come first: they take turns, see `service.catalog.fairness`."""
    queue = load.queued.get(job.queue, {})
    _, mine = queue.get(job.owner, (0, job.queued_at))
    return sum(min(count, before + (since < mine)) for owner, (count, since) in queue.items() if owner != job.owner)


def usual(deed: str, work: float | None, measured: History) -> Estimate | None:
    """What the whole of a job takes."""
    paces = measured.paces.get(deed, ())
    if not work or len(paces) < _FEWEST:
        return None
    return Estimate(*(work * _quantile(paces, share) for share in (_MIDDLE, _LOW, _HIGH)))


def _remaining(job: Job, own: Estimate | None) -> Estimate | None:
    """What is left of a running job: by what such jobs take, and the more it has done the more by its own pace."""
    if job.started_at is None:
        return None
    elapsed = max(0.0, (job.updated_at - job.started_at).total_seconds())
    done = min(1.0, job.fraction)
    of_others = None if own is None else _scaled(own, 1 - done)
    if done < _OWN_PACE:
        return of_others
    left = elapsed * (1 - done) / done
    paced = Estimate(left, left / _OWN_SPREAD, left * _OWN_SPREAD)
    if of_others is None:
        return paced
    return Estimate(
        *(
            (1 - done) * ours + done * theirs
            for ours, theirs in (
                (of_others.seconds, paced.seconds),
                (of_others.low, paced.low),
                (of_others.high, paced.high),
            )
        )
    )


def _wait(load: Load, measured: History, queue: str, before: int) -> Estimate | None:
    """How long a worker is waited for, with so many jobs of the same queue before; None without workers."""
    if load.slots == 0:
        return None
    # every worker takes from all queues in turn
    counts = {other: sum(count for count, _ in owners.values()) for other, owners in load.queued.items()}
    ahead = {other: before if other == queue else min(count, before) for other, count in counts.items()}
    if sum(ahead.values()) + load.running < load.slots:
        return Estimate(0.0, 0.0, 0.0)
    total, variance = load.remaining_s, 0.0
    for other, count in ahead.items():
        durations = measured.durations.get(other, ())
        mean = _mean(durations)
        if count and mean is None:
            return None
        if count and mean is not None:
            total += count * mean
            # the mean itself is known from few jobs
            each = sum((one - mean) ** 2 for one in durations) / max(1, len(durations) - 1)
            variance += count * each + count**2 * each / len(durations)
    spread = _SPREAD * math.sqrt(variance) + (_OWN_SPREAD - 1) / _OWN_SPREAD * load.remaining_s
    return _scaled(Estimate(total, max(0.0, total - spread), total + spread), 1 / load.slots)


def _after(wait: Estimate, own: Estimate) -> Estimate:
    """First the one, then the other: what is uncertain of both is not added up, for they are independent."""
    middle = wait.seconds + own.seconds
    low = math.hypot(wait.seconds - wait.low, own.seconds - own.low)
    high = math.hypot(wait.high - wait.seconds, own.high - own.seconds)
    return Estimate(middle, max(0.0, middle - low), middle + high)


def _scaled(one: Estimate, factor: float) -> Estimate:
    return Estimate(one.seconds * factor, one.low * factor, one.high * factor)


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if len(values) >= _FEWEST else None


def _quantile(ordered: Sequence[float], share: float) -> float:
    """Of sorted values, between two of them in proportion."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (place - below) * (ordered[above] - ordered[below])
