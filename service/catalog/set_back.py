"""After a clock was set back: what it dated before does not wait until that time comes round again.

Retention is left alone, since it is meant to be a time of its own; what is kept is kept for that much longer.
"""

from __future__ import annotations

from datetime import datetime, timedelta

from sqlalchemy import select, update
from sqlalchemy.orm import InstrumentedAttribute, Session

from service.catalog import tombstones
from service.catalog.database import changed
from service.catalog.idempotency import LOCK_S
from service.catalog.models import (
    Collection,
    Delivery,
    DeliveryState,
    IdempotentRequest,
    Job,
    JobState,
    Preview,
    Tombstone,
    Worker,
)


def mend(session: Session, *, now: datetime, lease_s: float, write_s: float) -> None:
    """Date nothing later than it can have been dated: leases end ``lease_s`` from now at the latest, and so on.

    ``write_s``: for which a blob may be written before it is recorded.
    """
    # as long as it runs a lease of a worker that was lost keeps its job
    _at_most(session, Job.lease_expires_at, now + timedelta(seconds=lease_s))
    for column in (Job.queued_at, Job.updated_at, Job.published_at):  # by which lost messages are told
        late = update(Job).where(Job.state == JobState.QUEUED, column > now)
        changed(session, late.values({column: now}))
    _at_most(session, Tombstone.due_at, now + timedelta(seconds=max(write_s, tombstones.LONGEST_WAIT_S)))
    _at_most(session, IdempotentRequest.locked_until, now + timedelta(seconds=LOCK_S))
    _at_most(session, Collection.began_at, now)
    _at_most(session, Preview.created_at, now)
    _at_most(session, Worker.seen_at, now)
    _mend_deliveries(session, now)


def _at_most(
    session: Session, column: InstrumentedAttribute[datetime] | InstrumentedAttribute[datetime | None], latest: datetime
) -> None:
    changed(session, update(column.class_).where(column > latest).values({column: latest}))


def _mend_deliveries(session: Session, now: datetime) -> None:
    """Those not attempted since they were asked for are due; others wait for as long from now as from their attempt."""
    pending = (Delivery.state == DeliveryState.PENDING, Delivery.next_at > now)
    changed(session, update(Delivery).where(*pending, Delivery.attempts == 0).values(next_at=now))
    columns = (Delivery.id, Delivery.next_at, Delivery.last_attempt_at)
    for one in session.execute(select(*columns).where(*pending, Delivery.last_attempt_at > now)).all():
        put_off = update(Delivery).where(Delivery.id == one.id, Delivery.next_at == one.next_at)
        changed(session, put_off.values(next_at=now + (one.next_at - one.last_attempt_at), last_attempt_at=now))
