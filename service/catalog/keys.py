"""Keys: who may use the service, what belongs to whom, and how much each may ask for and keep.

A key's text is ``pvg_``, its id's 32 hex digits, ``_`` and a secret of 256 random bits. Only the sha-256 of the secret
is stored. A slow hash, as passwords need, would add nothing: nobody can try 2²⁵⁶ secrets, whatever a try costs.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Final

from sqlalchemy import delete, exists, func, literal, select, update
from sqlalchemy.orm import Session, aliased

from service.catalog.database import changed
from service.catalog.models import (
    ACTIVE,
    Delivery,
    IdempotentRequest,
    Job,
    Key,
    Look,
    Media,
    PartFile,
    Result,
    ResumableUpload,
    UploadPart,
)
from service.catalog.requests import VectorSettings
from service.ids import new_id

#: the owner of what was made while there were no keys
NOBODY: Final = ""
#: seconds of the window in which requests are counted
WINDOW_S: Final = 60
#: what a piece of a file takes on a disk at least
PIECE_BYTES: Final = 4096

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


# what a key uses


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


def active_jobs(session: Session, owner: str) -> int:
    """How many unfinished jobs an owner has."""
    mine = (Job.state.in_(ACTIVE), Job.owner == owner, Job.parent_id.is_(None))
    return session.scalar(select(func.count()).select_from(Job).where(*mine)) or 0


def stored_bytes(session: Session, owner: str) -> int:
    """How many bytes an owner's media, assets, results and what its jobs in parts have drawn take.

    With them those that arrive in pieces will take, of which none counts for less than `PIECE_BYTES`.
    """
    of_media = func.sum(Media.size_bytes + func.coalesce(Media.asset_bytes, 0))
    media = session.scalar(select(of_media).where(Media.owner == owner)) or 0
    kept = (Result.owner == owner, Result.blob_key.is_not(None))
    results = session.scalar(select(func.sum(Result.size_bytes)).where(*kept)) or 0
    open_ = (ResumableUpload.owner == owner, ResumableUpload.media_id.is_(None))
    arriving = session.scalar(select(func.sum(ResumableUpload.size_bytes)).where(*open_)) or 0
    pieces = select(func.sum(PIECE_BYTES - UploadPart.size_bytes)).join(ResumableUpload).where(*open_)
    blocks = session.scalar(pieces.where(UploadPart.size_bytes < PIECE_BYTES)) or 0
    # few files, of jobs that go on: each asks for its job, not each of the owner's jobs for files
    is_mine = exists(select(Job.id).where(Job.id == PartFile.part_id, Job.owner == owner))
    drawn = session.scalar(select(func.sum(PartFile.size_bytes)).where(is_mine)) or 0
    return int(media) + int(results) + int(arriving) + int(blocks) + int(drawn)


def next_expiry(session: Session, owner: str) -> datetime | None:
    """When the first of an owner's bytes go by themselves: of an upload whose size is not known none count."""
    kept = (Result.owner == owner, Result.blob_key.is_not(None))
    open_ = (ResumableUpload.owner == owner, ResumableUpload.media_id.is_(None), ResumableUpload.size_bytes > 0)
    ends: Sequence[datetime | None] = (
        session.scalar(select(func.min(ResumableUpload.expires_at)).where(*open_)),
        session.scalar(select(func.min(Media.expires_at)).where(Media.owner == owner)),
        session.scalar(select(func.min(Result.expires_at)).where(*kept)),
    )
    return min((end for end in ends if end is not None), default=None)


@dataclass(frozen=True)
class Share:
    """Requests of one window that were handed to one process."""

    window: int
    granted: int
    #: of all processes, this share included
    taken: int


def is_ahead(held: int, window: int) -> bool:
    """Requests were counted in a window that no clock can be in yet: the clock was set back, and they count no more."""
    return held > window + 1


def take_share(session: Session, key_id: str, *, window: int, wanted: int) -> Share:
    """Hand at most ``wanted`` of a key's requests of this window to a process; fewer, or none, when others have them.

    ``window`` counts `WINDOW_S` from 1970. A process whose clock is a little behind gets of the window that others are
    in; see `is_ahead` for a clock that was set back.
    """
    key = session.get(Key, key_id, with_for_update=True)
    if key is None:  # keys are never deleted by the service
        return Share(window, 0, 0)
    current = window if is_ahead(key.window_number, window) else max(window, key.window_number)
    taken = key.window_requests if key.window_number == current else 0
    granted = max(0, min(wanted, key.requests_per_minute - taken))
    key.window_number, key.window_requests = current, taken + granted
    session.flush()
    return Share(current, granted, taken + granted)
