"""Which job a worker takes: that of the key that has the fewest running, then of the one served longest ago.

A message names a job of a key; when it is another key's turn, or another job has waited longer, the worker takes the
oldest job of the key whose turn it is, and the message of the named one is due again. So a queued job always has a
message of its own, and the order of messages, which that changes, does not matter: the jobs of a key are taken as they
were queued. A key with a thousand queued jobs holds up another's by one job at most.

The parts of a job that is done in parts are taken in turn with the key's other jobs: that job goes first of which the
fewest parts run, then the one that waits for the longest, where a job waits again from the end of each of its parts. So
a job that is queued while a part runs comes before the next part, and of two long ones neither waits for the other. A
join comes before all: it is short, and the files of its parts wait for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Final

from sqlalchemy import ColumnElement, and_, case, func, or_, select
from sqlalchemy.orm import Session, aliased

from service.catalog import leases
from service.catalog.messages import Message
from service.catalog.models import HELD, Job, JobState, PartKind
from service.catalog.transitions import Lease, Step, take_step

#: each try that fails is the end of another job
_TRIES: Final = 100


@dataclass(frozen=True)
class Taken:
    """A job taken. ``deferred`` is the message that named another one, to be sent again."""

    lease: Lease
    deferred: Message | None = None


def claim(session: Session, job_id: str, *, now: datetime, lease_s: float, token: str | None = None) -> Taken | None:
    """Take the job whose turn it is, on a message that names ``job_id``. None when that job is not to be had.

    ``token``: of the lease; see `leases.claimed`.
    """
    columns = (Job.queue, Job.owner, Job.kind, Job.parent_id, Job.queued_at)
    query = select(*columns).where(Job.id == job_id, *_available())
    if (named := session.execute(query).one_or_none()) is None:
        return None
    _await_turn(session, named.queue)
    for _ in range(_TRIES):
        named = session.execute(query).one_or_none()
        if named is None:
            return None
        queue, owner = named.queue, named.owner
        first = _next_owner(session, queue)
        chosen: str | None = job_id
        if first not in {None, owner}:
            chosen = _first_of(session, queue, str(first))
        elif named.kind == PartKind.PART:
            chosen = _first_of(session, queue, owner, instead_of=(job_id, named.parent_id))
        elif not _comes_first(session, queue, owner, (named.queued_at, job_id)):
            chosen = _first_of(session, queue, owner)
        if chosen is not None and chosen != job_id:
            # in the order in which others lock them
            both = select(Job.id).where(Job.id.in_((chosen, job_id))).order_by(Job.id).with_for_update()
            session.execute(both).all()
        lease = leases.claim(session, chosen, now=now, lease_s=lease_s, token=token) if chosen is not None else None
        if lease is None:
            continue  # it was canceled or expired in between
        due = chosen != job_id and take_step(session, Step.DEFER, job_id, now=now, values={"published_at": None})
        return Taken(lease, Message(job_id, queue) if due else None)
    return None


def _await_turn(session: Session, queue: str) -> None:
    """Let those who take a job of this queue do so one at a time: at once they would all choose the same one."""
    if session.get_bind().dialect.name != "sqlite":  # which has one writer anyway
        session.execute(select(func.pg_advisory_xact_lock(func.hashtext(f"claims of {queue}"))))


def _available() -> tuple[ColumnElement[bool], ...]:
    return Job.state == JobState.QUEUED, Job.waiting.is_(False)


def _next_owner(session: Session, queue: str) -> str | None:
    """Whose turn it is, of those who have a job in the queue."""
    queued = (
        select(Job.owner, func.min(Job.queued_at).label("since"))
        .where(Job.queue == queue, *_available())
        .group_by(Job.owner)
        .subquery()
    )
    held, past = aliased(Job), aliased(Job)
    running = (
        select(func.count())
        .select_from(held)
        .where(held.state.in_(HELD), held.lease_token.is_not(None), held.queue == queue, held.owner == queued.c.owner)
        .scalar_subquery()
    )
    served = (
        select(func.max(past.started_at)).where(past.queue == queue, past.owner == queued.c.owner).scalar_subquery()
    )
    turns = (running, served.asc().nulls_first(), queued.c.since, queued.c.owner)
    return session.scalar(select(queued.c.owner).order_by(*turns).limit(1))


def _comes_first(session: Session, queue: str, owner: str, since: tuple[datetime, str]) -> bool:
    """Whether a job, by when it was queued and its id, is plainly the first: none waits longer, and none is in parts.

    It spares looking for the first one where messages come in order, as they mostly do.
    """
    queued_at, job_id = since
    others = (
        Job.parent_id.is_not(None),
        Job.queued_at < queued_at,
        and_(Job.queued_at == queued_at, Job.id < job_id),
    )
    query = select(Job.id).where(Job.queue == queue, Job.owner == owner, *_available(), or_(*others))
    return session.scalar(query.limit(1)) is None


def _first_of(
    session: Session, queue: str, owner: str, *, instead_of: tuple[str, str | None] | None = None
) -> str | None:
    """Which of an owner's jobs in the queue is to be taken; ``instead_of`` a part, and the job it is a part of.

    The part itself, when it is that job's turn: its message is at hand.
    """
    whole = func.coalesce(Job.parent_id, Job.id).label("whole")
    last = case((Job.kind == PartKind.JOIN, 0), else_=1)
    mine = (Job.queue == queue, Job.owner == owner, *_available())
    queued = (
        select(
            whole,
            func.min(last).label("last"),
            func.min(Job.queued_at).label("since"),
            func.max(Job.parent_id).label("parent"),
        )
        .where(*mine)
        .group_by(whole)
        .subquery()
    )
    held, past = aliased(Job), aliased(Job)
    running = (
        select(func.count())
        .select_from(held)
        .where(held.parent_id == queued.c.whole, held.state.in_(HELD))
        .scalar_subquery()
    )
    ended = select(func.max(past.finished_at)).where(past.parent_id == queued.c.whole).scalar_subquery()
    # a job in one piece has no parts to be looked for, and there may be a thousand of them
    is_cut = queued.c.parent.is_not(None)
    since = func.coalesce(case((is_cut, ended)), queued.c.since)
    turns = (queued.c.last, case((is_cut, running), else_=0), since, queued.c.whole)
    first = session.scalar(select(queued.c.whole).order_by(*turns).limit(1))
    if first is None or (instead_of is not None and first == instead_of[1]):
        return instead_of[0] if instead_of is not None else None
    of_it = select(Job.id).where(or_(Job.id == first, Job.parent_id == first), *mine)
    return session.scalar(of_it.order_by(Job.queued_at, Job.id).limit(1))
