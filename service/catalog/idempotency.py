"""Requests that name an Idempotency-Key: done once, and answered again with the first answer.

A row is made when a request begins and locked while it is worked on; the transaction that records what the request
makes writes the answer into it. So the answer is kept exactly when there is something that must not be made twice.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Final

from sqlalchemy import ColumnElement, SelectBase, delete, or_, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service.catalog.database import changed
from service.catalog.models import IdempotentRequest

#: seconds for which a request that no longer says so counts as being worked on
LOCK_S: Final = 30.0


@dataclass(frozen=True)
class Claim:
    """The right of one request to answer for its Idempotency-Key. ``token``: up to 32 characters of its own."""

    owner: str
    key: str
    token: str


@dataclass(frozen=True)
class Answer:
    """A kept answer. ``digest`` is that of the request it was given to."""

    digest: str
    status: int
    location: str | None
    body: dict[str, Any]


class InUseError(Exception):
    """Another request with the same Idempotency-Key is being worked on.

    ``ask_in_s``: when to ask again. That is as long as it has not been heard of, so that a short request is asked for
    soon and one whose process was killed not often, and no longer than its lock lasts.
    """

    def __init__(self, ask_in_s: float = 0.0) -> None:
        super().__init__(ask_in_s)
        self.ask_in_s = ask_in_s


def begin(session: Session, claim: Claim, *, now: datetime, lock_s: float, ttl_s: float) -> Answer | None:
    """Claim a key for ``lock_s`` seconds, or return the answer that it has had. Raises `InUseError`.

    The same claim may be made again, in case that it was made and its request was not told.
    """
    owner, key = claim.owner, claim.key
    locked, expires = now + timedelta(seconds=lock_s), now + timedelta(seconds=ttl_s)
    found = session.get(IdempotentRequest, (owner, key), with_for_update=True)
    if found is None:
        row = IdempotentRequest(owner=owner, key=key, token=claim.token, locked_until=locked, expires_at=expires)
        try:
            with session.begin_nested():
                session.add(row)
        except IntegrityError as error:  # another one was faster
            raise InUseError from error
        return None
    if found.expires_at > now:
        if found.status is not None and found.digest is not None:
            return Answer(found.digest, found.status, found.location, found.body or {})
        if found.locked_until > now and found.token != claim.token:
            left_s = (found.locked_until - now).total_seconds()
            raise InUseError(min(left_s, lock_s - left_s))
    found.token, found.locked_until, found.expires_at = claim.token, locked, expires
    found.digest = found.status = found.location = found.body = found.resource_id = None
    return None


def hold(session: Session, claim: Claim, *, now: datetime, lock_s: float) -> bool:
    """Prolong the claim of a request that is still worked on. False when it is lost."""
    longer = update(IdempotentRequest).where(*_open(claim)).values(locked_until=now + timedelta(seconds=lock_s))
    return bool(changed(session, longer))


def keep(session: Session, claim: Claim, answer: Answer, *, resource_id: str) -> bool:
    """Keep the answer, in the transaction that makes what it tells of. False when the claim is lost."""
    values = {
        "digest": answer.digest,
        "status": answer.status,
        "location": answer.location,
        "body": answer.body,
        "resource_id": resource_id,
    }
    return bool(changed(session, update(IdempotentRequest).where(*_open(claim)).values(**values)))


def drop(session: Session, claim: Claim) -> None:
    """Free the key of a request that made nothing."""
    changed(session, delete(IdempotentRequest).where(*_open(claim)))


def forget(session: Session, resource_ids: Collection[str] | SelectBase) -> None:
    """Remove the answers that tell of things that are deleted: they may hold what was found in a face."""
    changed(session, delete(IdempotentRequest).where(IdempotentRequest.resource_id.in_(resource_ids)))


def expire(session: Session, *, now: datetime, limit: int) -> int:
    """Remove the answers past their time, at most ``limit``. Returns their number."""
    late = select(IdempotentRequest.token).where(
        IdempotentRequest.expires_at < now,
        or_(IdempotentRequest.status.is_not(None), IdempotentRequest.locked_until < now),
    )
    tokens = session.scalars(late.limit(limit)).all()
    return changed(session, delete(IdempotentRequest).where(IdempotentRequest.token.in_(tokens)))


def _open(claim: Claim) -> tuple[ColumnElement[bool], ...]:
    row = IdempotentRequest
    return row.owner == claim.owner, row.key == claim.key, row.token == claim.token, row.status.is_(None)
