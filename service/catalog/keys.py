"""Keys: who may use the service, what belongs to whom, and how much each may ask for and keep.

How much that is at the moment is counted in `amounts`, requests in `windows`.

A key's text is ``pvg_``, its id's 32 hex digits, ``_`` and a secret of 256 random bits. Only the sha-256 of the secret
is stored. A slow hash, as passwords need, would add nothing: nobody can try 2²⁵⁶ secrets, whatever a try costs.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Final

from sqlalchemy import delete, exists, func, literal, select, update
from sqlalchemy.orm import Session, aliased

from service.catalog.database import changed
from service.catalog.models import (
    Delivery,
    IdempotentRequest,
    Job,
    Key,
    Look,
    Media,
    Result,
    ResumableUpload,
)
from service.catalog.requests import VectorSettings
from service.ids import new_id

#: the owner of what was made while there were no keys
NOBODY: Final = ""

_TEXT: Final = re.compile(r"pvg_([0-9a-f]{32})_([A-Za-z0-9_-]{43})")
_ID: Final = re.compile(r"key_[0-9a-f]{32}")
_SECRET_BYTES: Final = 32
#: hex digits of a hashed secret
_SEAL_DIGITS: Final = 32
_NO_HASH: Final = "0" * 64


@dataclass(frozen=True)
class Limits:
    """What a key may ask for and keep: requests in a minute, unfinished jobs, bytes of media, assets and results."""

    requests_per_minute: int = 600
    active_jobs: int = 1000
    stored_bytes: int = 100 * 1024**3


def create(session: Session, name: str, limits: Limits, *, now: datetime) -> tuple[Key, str]:
    """Record a new key; its text is returned here and never again.

    Raises `sqlalchemy.exc.IntegrityError` at flush for a name that another key has.
    """
    key = Key(id=new_id("key"), name=name, created_at=now, window_number=0, window_requests=0)
    _set_limits(key, limits)
    text = _new_secret(key)
    session.add(key)
    session.flush()
    return key, text


def rotate(key: Key, *, former_until: datetime | None = None) -> str:
    """Give a key another secret, returned here and never again; what it owns stays.

    The former one is good ``former_until`` then, or ends now; one before that ends now.
    """
    key.former_sha256 = None if former_until is None else key.secret_sha256
    key.former_until = former_until
    return _new_secret(key)


def _new_secret(key: Key) -> str:
    secret = secrets.token_urlsafe(_SECRET_BYTES)
    key.secret_sha256 = _hash(secret)
    return f"pvg_{key.id.removeprefix('key_')}_{secret}"


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def _set_limits(key: Key, limits: Limits) -> None:
    key.requests_per_minute = limits.requests_per_minute
    key.active_jobs = limits.active_jobs
    key.stored_bytes = limits.stored_bytes


def limits_of(key: Key) -> Limits:
    """What a key may ask for and keep."""
    return Limits(key.requests_per_minute, key.active_jobs, key.stored_bytes)


def limit(key: Key, limits: Limits) -> None:
    """Change what a key may ask for and keep."""
    _set_limits(key, limits)


def find(session: Session, text: str, *, now: datetime) -> Key | None:
    """The key of this text; None for one that is malformed, unknown, of a former secret that has ended, or revoked."""
    parts = _TEXT.fullmatch(text)
    if parts is None:
        return None
    key = session.get(Key, f"key_{parts[1]}")
    # compared in the same time whether or not there is such a key
    hashes = _hashes(key, now) if key is not None else [_NO_HASH]
    fits = any(hmac.compare_digest(_hash(parts[2]), one) for one in hashes)
    return key if key is not None and fits and key.revoked_at is None else None


def _hashes(key: Key, now: datetime) -> list[str]:
    """Of the secrets of a key that are good: the present one first."""
    former = key.former_sha256 if former_until(key, now=now) is not None else None
    return [key.secret_sha256, *([former] if former is not None else [])]


def former_until(key: Key, *, now: datetime) -> datetime | None:
    """Until when a former secret of a key is good as well; None when there is none that is."""
    until = key.former_until if key.revoked_at is None else None
    return until if until is not None and now < until else None


def by_name(session: Session, name: str) -> Key | None:
    """The key of this name or id, revoked or not."""
    return session.scalar(select(Key).where((Key.name == name) | (Key.id == name)))


def every(session: Session) -> list[Key]:
    """All keys, revoked ones too, oldest first."""
    return list(session.scalars(select(Key).order_by(Key.id)))


def exist(session: Session) -> bool:
    """True once a key was made. Revoked ones count: a service whose last key is revoked is closed, not open."""
    return session.scalar(select(literal(1)).where(exists(select(Key.id)))) is not None


def revoke(session: Session, key: Key, *, now: datetime) -> bool:
    """End a key for good. What it owns stays, and goes after its retention. False when it was revoked before."""
    ended = update(Key).where(Key.id == key.id, Key.revoked_at.is_(None)).values(revoked_at=now)
    return changed(session, ended) == 1


def adopt(session: Session, key: Key, *, owner: str = NOBODY) -> tuple[int, int]:
    """Give a key all media, jobs and results of another owner. Returns the numbers of media given and left.

    A medium that the key has already, of the same bytes and settings, stays where it is, with what was made of it.
    Answers kept for an `Idempotency-Key` of the other owner go: they tell of what is the key's now.
    """
    own = aliased(Media)
    same = exists(
        select(own.id).where(
            own.owner == key.id,
            *(getattr(own, name) == getattr(Media, name) for name in ("role", "sha256", *_SETTINGS)),
        )
    )
    given = changed(session, update(Media).where(Media.owner == owner, ~same).values(owner=key.id))
    # what was made of media that stay, stays with them
    stay = select(Media.id).where(Media.owner == owner)
    looks = select(Look.job_id).where(Look.video_id.in_(stay) | Look.reference_id.in_(stay))
    theirs = (Job.id.not_in(looks), Job.media_id.is_(None) | Job.media_id.not_in(stay), Job.parent_id.is_(None))
    changed(session, update(Job).where(Job.owner == owner, *theirs).values(owner=key.id))
    given_jobs = select(Job.id).where(Job.owner == key.id)
    changed(session, update(Job).where(Job.owner == owner, Job.parent_id.in_(given_jobs)).values(owner=key.id))
    with_jobs = Delivery.job_id.in_(select(Job.id).where(Job.owner == key.id))
    changed(session, update(Delivery).where(Delivery.owner == owner, with_jobs).values(owner=key.id))
    made = (Result.owner == owner, Result.video_id.not_in(stay), Result.reference_id.not_in(stay))
    changed(session, update(Result).where(*made).values(owner=key.id))
    uploads = (
        ResumableUpload.owner == owner,
        ResumableUpload.media_id.is_(None) | ResumableUpload.media_id.not_in(stay),
    )
    changed(session, update(ResumableUpload).where(*uploads).values(owner=key.id))
    changed(session, delete(IdempotentRequest).where(IdempotentRequest.owner == owner))
    left = select(func.count()).select_from(Media).where(Media.owner == owner)
    return given, session.scalar(left) or 0


_SETTINGS: Final = tuple(one.name for one in fields(VectorSettings))


def get(session: Session, owner: str) -> Key | None:
    """The key of this owner; None for nobody."""
    return session.get(Key, owner) if owner != NOBODY else None


def seals(session: Session, owner: str, *, now: datetime) -> list[str]:
    """What may be signed into the links of a key, which end with its secret; into new ones goes the first.

    One that is empty for nobody, or no key.
    """
    key = get(session, owner) if _ID.fullmatch(owner) else None
    return [one[:_SEAL_DIGITS] for one in _hashes(key, now)] if key is not None else [""]


def lock(session: Session, owner: str) -> Key | None:
    """The key of this owner, kept from other transactions that ask for it, so that its quotas are exact."""
    return session.get(Key, owner, with_for_update=True) if owner != NOBODY else None
