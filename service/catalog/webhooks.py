"""Webhooks: who is to be told of a job's end, and whether they were; and what the messages are signed with.

A delivery is recorded with its job and waits. The UPDATE that ends the job is followed, in the same transaction, by the
one that makes its deliveries due (`service.catalog.transitions.take_step`), so whoever ends a job, each receiver is
told once, with one id; one that is named when the job has ended is told then, with an id of its own. This table is the
queue: a delivery is attempted by whoever claims it by a conditional UPDATE, and is due again when that one is not heard
of.
"""

from __future__ import annotations

import base64
import secrets
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final
from urllib.parse import urlsplit

from sqlalchemy import and_, func, not_, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service.catalog.database import changed
from service.catalog.models import ENDED, Delivery, DeliveryState, Job, Look, WebhookSecret
from service.ids import new_id

#: of a signing secret: 24 to 64 bytes (Standard Webhooks 1.0.0)
_SECRET_BYTES: Final = 32
SECRET_PREFIX: Final = "whsec_"  # noqa: S105 - no secret
#: seconds for which a replaced secret is signed with as well, and of how many at a time that is promised
FORMER_SECRET_S: Final = 86_400.0
FORMER_SECRETS: Final = 4


class TooManySecretsError(Exception):
    """An owner has replaced as many secrets as are signed with beside the current one; ``until`` then."""

    def __init__(self, until: datetime) -> None:
        super().__init__(f"{FORMER_SECRETS} former secrets are signed with")
        self.until = until


def announce(session: Session, job: Job, url: str, *, now: datetime) -> None:
    """Have a receiver told of a job's end; at once, and whether or not it was told before, if it has ended already.

    A receiver that waits for the end of this job already is told once all the same.
    """
    waits = (Delivery.job_id == job.id, Delivery.url == url, Delivery.state == DeliveryState.WAITING)
    if session.scalar(select(Delivery.id).where(*waits).limit(1)) is not None:
        return
    has_ended = job.state in ENDED
    parts = urlsplit(url)
    made = Delivery(
        id=new_id("msg"),
        owner=job.owner,
        job_id=job.id,
        url=url,
        origin=f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}".lower()[:300],
        state=DeliveryState.PENDING if has_ended else DeliveryState.WAITING,
        attempts=0,
        next_at=now if has_ended else None,
        created_at=now,
    )
    with suppress(IntegrityError), session.begin_nested():  # another request named it at the same time
        session.add(made)


def wake(session: Session, *, now: datetime) -> int:
    """Make due what waits for a job that has ended. Returns how many there were.

    That is for jobs that ended while a receiver was being recorded, which neither transaction saw of the other.
    """
    over = select(Job.id).where(Job.id == Delivery.job_id, Job.state.in_(ENDED)).exists()
    late = update(Delivery).where(Delivery.state == DeliveryState.WAITING, over)
    return changed(session, late.values(state=DeliveryState.PENDING, next_at=now))


# attempts


@dataclass(frozen=True)
class Due:
    """A delivery that can be attempted."""

    delivery_id: str
    owner: str
    origin: str


@dataclass(frozen=True)
class Attempt:
    """The right to attempt a delivery for a while, and what it needs. ``number`` counts from 1."""

    delivery: Delivery
    job: Job
    looks: Sequence[Look]
    secrets: tuple[str, ...]
    token: str
    number: int


def due(
    session: Session,
    *,
    now: datetime,
    limit: int,
    not_to: Collection[tuple[str, str]] = (),
    not_of: Collection[str] = (),
) -> list[Due]:
    """Deliveries to attempt now: of each owner the one that is due longest, then of each the second, and so on.

    So no owner's many hide another's one. Left out are those of some owners to some origins, ``not_to``, and all of
    some owners.
    """
    turn = func.row_number().over(partition_by=Delivery.owner, order_by=(Delivery.next_at, Delivery.id))
    query = select(Delivery.id, Delivery.owner, Delivery.origin).where(
        Delivery.state == DeliveryState.PENDING,
        Delivery.next_at <= now,
        Delivery.owner.not_in(not_of),
        *(not_(and_(Delivery.owner == owner, Delivery.origin == origin)) for owner, origin in not_to),
    )
    return [Due(*row) for row in session.execute(query.order_by(turn, Delivery.next_at, Delivery.id).limit(limit))]


def claim(session: Session, delivery_id: str, *, now: datetime, lease_s: float) -> Attempt | None:
    """Take a delivery that is due for ``lease_s`` seconds. None when it is not available.

    One that another transaction has locked is not: who claims several would wait for one who waits for it.
    """
    token = secrets.token_hex(16)
    is_due = (Delivery.id == delivery_id, Delivery.state == DeliveryState.PENDING, Delivery.next_at <= now)
    free = select(Delivery.id).where(*is_due).with_for_update(skip_locked=True)
    values = {
        "lease_token": token,
        "next_at": now + timedelta(seconds=lease_s),
        "attempts": Delivery.attempts + 1,
        "last_attempt_at": now,
    }
    if not changed(session, update(Delivery).where(Delivery.id == free.scalar_subquery()).values(values)):
        return None
    delivery = session.get(Delivery, delivery_id, populate_existing=True)
    job = session.get(Job, delivery.job_id, populate_existing=True) if delivery is not None else None
    if delivery is None or job is None:
        return None
    looks = session.scalars(select(Look).where(Look.job_id == job.id).order_by(Look.position)).all()
    return Attempt(delivery, job, looks, signing_secrets(session, job.owner, now=now), token, delivery.attempts)


def succeeded(session: Session, attempt: Attempt, status: int, *, now: datetime) -> bool:
    """The receiver has taken it. False when the claim was lost meanwhile, and nothing was changed."""
    return _conclude(
        session, attempt, state=DeliveryState.DELIVERED, next_at=None, last_status=status, delivered_at=now
    )


def missed(
    session: Session, attempt: Attempt, *, now: datetime, retry_s: float | None, status: int | None, error: str
) -> bool:
    """The receiver has not taken it: it is due again in ``retry_s`` seconds, or has failed when that is None.

    False when the claim was lost meanwhile, and nothing was changed.
    """
    state = DeliveryState.FAILED if retry_s is None else DeliveryState.PENDING
    next_at = None if retry_s is None else now + timedelta(seconds=retry_s)
    return _conclude(session, attempt, state=state, next_at=next_at, last_status=status, last_error=error[:80])


def give_back(session: Session, attempt: Attempt, *, now: datetime) -> bool:
    """The receiver was not asked: it is due again now, and this was no attempt. False as `missed`."""
    delivery = attempt.delivery
    return _conclude(session, attempt, next_at=now, attempts=attempt.number - 1, last_error=delivery.last_error)


def _conclude(session: Session, attempt: Attempt, **values: object) -> bool:
    held = (Delivery.id == attempt.delivery.id, Delivery.lease_token == attempt.token)
    written = {"lease_token": None, "last_error": None, **values}
    return bool(changed(session, update(Delivery).where(*held).values(written)))


# what owners see and ask for


def get(session: Session, delivery_id: str, *, owner: str) -> Delivery | None:
    """An owner's delivery, or None."""
    found = session.get(Delivery, delivery_id, populate_existing=True)
    return found if found is not None and found.owner == owner else None


def page(
    session: Session,
    owner: str,
    *,
    states: Collection[str] = (),
    job_id: str | None = None,
    before: str | None,
    limit: int,
) -> list[tuple[Delivery, str]]:
    """Deliveries of an owner with the states of their jobs, newest first, older than the id ``before``."""
    query = select(Delivery, Job.state).join(Job, Job.id == Delivery.job_id).where(Delivery.owner == owner)
    if before is not None:
        query = query.where(Delivery.id < before)
    if states:
        query = query.where(Delivery.state.in_(states))
    if job_id is not None:
        query = query.where(Delivery.job_id == job_id)
    return [(row[0], row[1]) for row in session.execute(query.order_by(Delivery.id.desc()).limit(limit))]


def replay(session: Session, delivery_id: str, *, now: datetime) -> bool:
    """Attempt a delivery again from now on, with its id. False while its job goes on: nothing was changed.

    Who is attempting it just now loses the claim: how that ends does not count.
    """
    over = Delivery.state.in_((DeliveryState.PENDING, DeliveryState.DELIVERED, DeliveryState.FAILED))
    values = {
        "state": DeliveryState.PENDING,
        "next_at": now,
        "attempts": 0,
        "delivered_at": None,
        "lease_token": None,
    }
    return bool(changed(session, update(Delivery).where(Delivery.id == delivery_id, over).values(values)))


# secrets


def known_secret(session: Session, owner: str) -> WebhookSecret | None:
    """What an owner's webhooks are signed with; None when there is none yet."""
    return session.get(WebhookSecret, owner, populate_existing=True)


def secret(session: Session, owner: str, *, now: datetime) -> WebhookSecret:
    """What an owner's webhooks are signed with; made when there is none yet."""
    found = known_secret(session, owner)
    if found is not None:
        return found
    made = WebhookSecret(owner=owner, secret=_new_secret(), created_at=now)
    try:
        with session.begin_nested():
            session.add(made)
    except IntegrityError:  # another process made it at the same time
        found = known_secret(session, owner)
        assert found is not None, "secrets are deleted with all of a revoked key only"  # noqa: S101
        return found
    return made


def rotate(session: Session, owner: str, *, now: datetime) -> WebhookSecret:
    """Give an owner another secret. For `FORMER_SECRET_S` messages are signed with the former one too.

    Those before keep the time that was promised for them. Raises `TooManySecretsError` when they are
    `FORMER_SECRETS`: nothing was changed.
    """
    held = session.get(WebhookSecret, owner, with_for_update=True, populate_existing=True)
    if held is None:
        return secret(session, owner, now=now)
    still = _former(held, now=now)
    if len(still) >= FORMER_SECRETS:
        raise TooManySecretsError(min(until for _, until in still))
    # the last one in columns of its own, where versions that know one alone look for it
    held.older = [[former, until.isoformat()] for former, until in still]
    held.former, held.former_until = held.secret, now + timedelta(seconds=FORMER_SECRET_S)
    held.secret, held.created_at = _new_secret(), now
    session.flush()
    return held


def signing_secrets(session: Session, owner: str, *, now: datetime) -> tuple[str, ...]:
    """The secrets that a message of an owner is signed with now, the newest first."""
    held = secret(session, owner, now=now)
    return held.secret, *(former for former, _ in _former(held, now=now))


def _former(held: WebhookSecret, *, now: datetime) -> list[tuple[str, datetime]]:
    """The replaced secrets that are signed with still, the newest first, and until when."""
    told = [(former, datetime.fromisoformat(until)) for former, until in held.older or ()]
    if held.former is not None and held.former_until is not None:
        told.insert(0, (held.former, held.former_until))
    return [(former, until) for former, until in told if until > now]


def _new_secret() -> str:
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(_SECRET_BYTES)).decode()
