"""What is likely of jobs that have not ended: their place in the queue, and when they will be done.

Measured, not modelled: how long recent jobs that did the same took for each unit of their work, what a running job has
done already, and what stands before a queued one, for as many workers as are alive. A unit of rendering is a pixel of
a frame of a look; of vectorising it is a byte of the file, since its frames are known only afterwards. Where nothing
like a job has been measured nothing is said of it.

What a job does is called its deed here: it vectorises a video, or a reference, which takes a fraction of that, or
renders.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from operator import itemgetter
from typing import Final

from sqlalchemy import ColumnElement, and_, bindparam, func, or_, select
from sqlalchemy.orm import Session

from service.catalog.models import HELD, Job, JobKind, JobState, Look, Media, Role, Worker

#: recent jobs of a deed that are measured, and how few of them say something
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
    """What recent jobs took, by deed: seconds for a unit of work, sorted, and seconds of whole jobs."""

    paces: Mapping[str, Sequence[float]] = field(default_factory=dict)
    durations: Mapping[str, Sequence[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Waiting:
    """The jobs of an owner that wait in a queue: how many, by deed, and since when the first of them."""

    counts: Mapping[str, float]
    since: datetime


@dataclass(frozen=True)
class Load:
    """What the workers have to do: how many they are, seconds that their jobs still take, and who waits where."""

    slots: int
    running: int
    remaining_s: float
    #: by queue, then by owner
    queued: Mapping[str, Mapping[str, Waiting]]


def history(session: Session) -> History:
    """What the newest succeeded jobs of each deed took. Its queries are as many whatever there is."""
    newest = _DONE.order_by(Job.finished_at.desc()).limit(_MEASURED)
    found = [job for alike in _ALIKE for job in session.scalars(newest.where(*alike))]
    works = _works(session, found)
    ends: defaultdict[str, list[tuple[datetime, float, float | None]]] = defaultdict(list)
    for job in found:
        if job.started_at is not None and job.finished_at is not None:
            seconds = max(0.001, (job.finished_at - job.started_at).total_seconds())
            ends[_deed(job)].append((job.finished_at, seconds, works.get(job.id)))
    paces, durations = {}, {}
    for deed, of_one in ends.items():
        measured = sorted(of_one, key=itemgetter(0), reverse=True)[:_MEASURED]  # one deed is of two kinds
        durations[deed] = [seconds for _, seconds, _ in measured]
        paces[deed] = sorted(seconds / work for _, seconds, work in measured if work)
    return History(paces, durations)


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
        mine = places.get(job.id)
        if mine is None or load is None:  # it was taken in between
            continue
        before = _before(load, job, mine)
        position = 1 + round(sum(before.values()))
        answers[job.id] = Forecast(position, until_done(load, measured, job.queue, before, own))
    return answers


def until_done(
    load: Load, measured: History, queue: str, before: Mapping[str, float], own: Estimate | None
) -> Estimate | None:
    """When a queued job will be done that takes ``own`` by itself; None when nobody knows.

    ``before``: how many of its queue come first, by deed.
    """
    wait = _wait(load, measured, queue, before)
    return None if own is None or wait is None else _after(wait, own)


def _waits_for_a_worker(job: Job) -> bool:
    return job.state == JobState.QUEUED and not job.waiting


def _deed(job: Job) -> str:
    return _deed_of(job.kind, job.request.get("role"))


def _deed_of(kind: str, role: str | None) -> str:
    return f"vectorize {role}" if kind == JobKind.VECTORIZE else "render"


def _works(session: Session, found: Sequence[Job]) -> dict[str, float]:
    """The units of work of jobs, by id, as far as they are known."""
    read = {job.id: job.media_id for job in found if job.kind == JobKind.VECTORIZE and job.media_id}
    files = select(Media.id, Media.size_bytes).where(Media.id.in_(set(read.values())))
    sizes = {row.id: float(row.size_bytes) for row in session.execute(files)} if read else {}
    works = defaultdict(float, {job_id: sizes[media_id] for job_id, media_id in read.items() if media_id in sizes})
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
        whole = _mean(measured.durations.get(_deed(job), ()))
        own = None if whole is None else Estimate(whole, whole, whole)
        left = _remaining(job, own)
        remaining += left.seconds if left is not None else 0.0
    queued: defaultdict[str, dict[str, Waiting]] = defaultdict(dict)
    for queue, owner, kind, role, count, since in session.execute(_WAITING):
        others = queued[queue].get(owner, Waiting({}, since))
        counts = _sum((others.counts, {_deed_of(kind, role): count}))
        queued[queue][owner] = Waiting(counts, min(since, others.since))
    return Load(slots, len(held), remaining, queued)


def _available() -> tuple[ColumnElement[bool], ...]:
    # a job that is done in parts counts as the one job it is
    return Job.state == JobState.QUEUED, Job.waiting.is_(False), Job.parent_id.is_(None)


#: of the medium that a job vectorises
_ROLE: Final = Job.request["role"].as_string()
#: jobs whose newest are looked for together; an index has them by kind
_ALIKE: Final = (
    *((Job.kind == JobKind.VECTORIZE, role == _ROLE) for role in Role),
    *((Job.kind == kind,) for kind in JobKind if kind is not JobKind.VECTORIZE),
)
_DONE: Final = select(Job).where(
    *(Job.state == JobState.SUCCEEDED, Job.parent_id.is_(None)),
    *(Job.started_at.is_not(None), Job.finished_at.is_not(None)),
)

# of every answer that shows a queued job, inside the transaction that makes it: to build them takes as long as to run
# them, so that they are built once
_ALIVE: Final = select(func.count()).where(
    Worker.seen_at >= bindparam("since", type_=Worker.seen_at.type), Worker.lacks.is_(None), Worker.kind == "jobs"
)
_AT_WORK: Final = select(Job).where(Job.state.in_(HELD), Job.parent_id.is_(None))
_WAITING: Final = (
    select(Job.queue, Job.owner, Job.kind, _ROLE, func.count(), func.min(Job.queued_at))
    .where(*_available())
    .group_by(Job.queue, Job.owner, Job.kind, _ROLE)
)
_SINCE: Final = bindparam("since", type_=Job.queued_at.type)
_BEFORE: Final = (
    select(Job.kind, _ROLE, func.count())
    .where(
        *(Job.queue == bindparam("queue"), Job.owner == bindparam("owner"), *_available()),
        or_(Job.queued_at < _SINCE, and_(Job.queued_at == _SINCE, Job.id < bindparam("id"))),
    )
    .group_by(Job.kind, _ROLE)
)
_DRAWN: Final = (
    select(Look.job_id, Media.info)
    .join(Media, Media.id == Look.video_id)
    .where(Look.job_id.in_(bindparam("ids", expanding=True)))
)


def _places(session: Session, queued: Sequence[Job]) -> dict[str, Mapping[str, float]]:
    """How many of the same owner's jobs stand before each of these in their queues, by deed."""
    if len(queued) == 1:
        (job,) = queued
        of_it = {"queue": job.queue, "owner": job.owner, "since": job.queued_at, "id": job.id}
        counts = ({_deed_of(kind, role): count} for kind, role, count in session.execute(_BEFORE, of_it))
        return {job.id: _sum(counts)}
    wanted = {job.id for job in queued}
    places: dict[str, Mapping[str, float]] = {}
    for queue, owner in {(job.queue, job.owner) for job in queued}:
        all_of_it = select(Job.id, Job.kind, _ROLE).where(Job.queue == queue, Job.owner == owner, *_available())
        before: defaultdict[str, float] = defaultdict(float)
        for job_id, kind, role in session.execute(all_of_it.order_by(Job.queued_at, Job.id)):
            if job_id in wanted:
                places[job_id] = before.copy()
            before[_deed_of(kind, role)] += 1
    return places


def _before(load: Load, job: Job, mine: Mapping[str, float]) -> dict[str, float]:
    """How many jobs of its queue are likely to come before one that has ``mine`` of its owner's before it, by deed.

    Other owners take turns with its own, see `service.catalog.fairness`.
    """
    queue = load.queued.get(job.queue, {})
    since = queue[job.owner].since if job.owner in queue else job.queued_at
    turns = sum(mine.values())
    others = (
        _first(waiting.counts, turns + (waiting.since < since))
        for owner, waiting in queue.items()
        if owner != job.owner
    )
    return _sum((mine, *others))


def _first(counts: Mapping[str, float], most: float) -> dict[str, float]:
    """The first ``most`` jobs of these, by deed: their order is not known, so in proportion."""
    total = sum(counts.values())
    return {deed: count * min(total, most) / total for deed, count in counts.items()}


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


def _wait(load: Load, measured: History, queue: str, before: Mapping[str, float]) -> Estimate | None:
    """How long a worker is waited for, with these jobs of the same queue before; None when nobody knows."""
    if load.slots == 0:
        return None
    # every worker takes from all queues in turn
    turns = round(sum(before.values()))
    others = (
        _first(_sum(waiting.counts for waiting in owners.values()), turns)
        for other, owners in load.queued.items()
        if other != queue
    )
    ahead = _sum((before, *others))
    if round(sum(ahead.values())) + load.running < load.slots:
        return Estimate(0.0, 0.0, 0.0)
    total, variance = load.remaining_s, 0.0
    for deed, count in ahead.items():
        durations = measured.durations.get(deed, ())
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


def _sum(counts: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Of numbers of jobs by deed."""
    summed: defaultdict[str, float] = defaultdict(float)
    for of_one in counts:
        for deed, count in of_one.items():
            summed[deed] += count
    return dict(summed)


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if len(values) >= _FEWEST else None


def _quantile(ordered: Sequence[float], share: float) -> float:
    """Of sorted values, between two of them in proportion."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (place - below) * (ordered[above] - ordered[below])
