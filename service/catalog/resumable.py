"""Files that arrive in pieces: each piece is a blob of its own, so that whichever API takes the next one has them all.

A piece counts when the offset moves, by one conditional update: of two that begin at the same byte, one is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, delete, func, select, update
from sqlalchemy.orm import Session

from service.catalog import idempotency, tombstones
from service.catalog.database import changed
from service.catalog.models import ResumableUpload, Role, UploadPart
from service.catalog.requests import VectorSettings
from service.ids import new_id


def create(
    session: Session,
    role: Role,
    settings: VectorSettings,
    *,
    owner: str,
    limit_bytes: int,
    now: datetime,
    ttl_s: float,
    size_bytes: int | None = None,
    filename: str | None = None,
    said: str | None = None,
    metadata: Mapping[str, str] | None = None,
    webhook: str | None = None,
) -> ResumableUpload:
    """Record a file that is to arrive; without ``size_bytes``, its size is said by `begin`."""
    upload = ResumableUpload(
        id=new_id("upl"),
        owner=owner,
        role=role,
        **asdict(settings),
        metadata_=dict(metadata or {}),
        webhook=webhook,
        filename=filename,
        said=said,
        limit_bytes=limit_bytes,
        size_bytes=size_bytes,
        offset_bytes=0,
        created_at=now,
        expires_at=now + timedelta(seconds=ttl_s),
    )
    session.add(upload)
    session.flush()
    return upload


def get(
    session: Session, upload_id: str, *, owner: str | None = None, now: datetime, lock: bool = False
) -> ResumableUpload | None:
    """The upload, or None when it has expired or, with an ``owner``, is another's."""
    found = session.get(ResumableUpload, upload_id, with_for_update=True if lock else None, populate_existing=lock)
    if found is None or owner not in {None, found.owner} or found.expires_at < now:
        return None
    return found


def page(session: Session, owner: str, *, before: str | None, limit: int, now: datetime) -> list[ResumableUpload]:
    """Files of an owner that are announced and have not arrived, newest first, older than the id ``before``."""
    query = select(ResumableUpload).where(*_open(owner, now)).order_by(ResumableUpload.id.desc()).limit(limit)
    return list(session.scalars(query if before is None else query.where(ResumableUpload.id < before)))


def begin(
    session: Session, upload: ResumableUpload, *, size_bytes: int, filename: str | None, said: str | None
) -> bool:
    """Say the size of a file of which nothing is known yet. False when it is known."""
    fresh = update(ResumableUpload).where(
        ResumableUpload.id == upload.id, ResumableUpload.size_bytes.is_(None), ResumableUpload.media_id.is_(None)
    )
    begun = changed(session, fresh.values(size_bytes=size_bytes, filename=filename, said=said)) == 1
    session.refresh(upload)
    return begun


def append(
    session: Session, upload_id: str, *, start: int, size_bytes: int, blob_key: str, now: datetime, ttl_s: float
) -> bool:
    """Record the bytes that begin at ``start``, and count the retention from now.

    False, and nothing changed, when others were recorded there. Raises `LateError` when the blob took so long to be
    written that it is deleted.
    """
    row = ResumableUpload
    here = (row.id == upload_id, row.offset_bytes == start, row.media_id.is_(None), row.expires_at >= now)
    if not changed(session, update(row).where(*here).values(offset_bytes=start + size_bytes)):
        return False
    keep(session, upload_id, now=now, ttl_s=ttl_s)
    if not tombstones.recorded(session, [blob_key]):
        raise tombstones.LateError(blob_key)
    session.add(UploadPart(upload_id=upload_id, start_bytes=start, size_bytes=size_bytes, blob_key=blob_key))
    session.flush()
    return True


def keep(session: Session, upload_id: str, *, now: datetime, ttl_s: float) -> None:
    """Count the retention of an upload from now, unless it is longer: its bytes come."""
    row, longer = ResumableUpload, now + timedelta(seconds=ttl_s)
    changed(session, update(row).where(row.id == upload_id, row.expires_at < longer).values(expires_at=longer))


def parts(session: Session, upload_id: str) -> list[UploadPart]:
    """What has been recorded, in order."""
    mine = select(UploadPart).where(UploadPart.upload_id == upload_id).order_by(UploadPart.start_bytes)
    return list(session.scalars(mine))


def count(session: Session, upload_id: str) -> int:
    """How many parts there are."""
    return session.scalar(select(func.count()).select_from(UploadPart).where(UploadPart.upload_id == upload_id)) or 0


def count_open(session: Session, owner: str, *, now: datetime) -> int:
    """How many files of an owner are announced and have not arrived."""
    return session.scalar(select(func.count()).select_from(ResumableUpload).where(*_open(owner, now))) or 0


def _open(owner: str, now: datetime) -> list[ColumnElement[bool]]:
    row = ResumableUpload
    return [row.owner == owner, row.media_id.is_(None), row.expires_at >= now]


def close(
    session: Session,
    upload: ResumableUpload,
    *,
    media_id: str,
    size_bytes: int,
    now: datetime,
    filename: str | None = None,
) -> None:
    """The file is a medium now, in this transaction: its parts go. ``filename`` is its name where it came with it."""
    upload.media_id, upload.size_bytes, upload.offset_bytes = media_id, size_bytes, size_bytes
    upload.filename = filename or upload.filename
    session.flush()
    _drop_parts(session, upload.id, now=now)


def remove(session: Session, upload: ResumableUpload, *, now: datetime) -> list[str]:
    """Remove an upload with what has arrived of it. Returns the blobs to delete after the commit."""
    keys = _drop_parts(session, upload.id, now=now)
    idempotency.forget(session, [upload.id])
    session.delete(upload)
    session.flush()
    return keys


def forget(session: Session, media_id: str) -> None:
    """Remove the records of the uploads that a medium, which is deleted, was made of."""
    its = ResumableUpload.media_id == media_id
    idempotency.forget(session, select(ResumableUpload.id).where(its))  # the answers to their beginnings have its name
    changed(session, delete(ResumableUpload).where(its))


def expire(session: Session, *, now: datetime, limit: int) -> int:
    """Remove the uploads past their retention, at most ``limit``. Returns their number."""
    late = select(ResumableUpload).where(ResumableUpload.expires_at < now).order_by(ResumableUpload.id).limit(limit)
    found = session.scalars(late.with_for_update()).all()
    for upload in found:
        remove(session, upload, now=now)
    return len(found)


def _drop_parts(session: Session, upload_id: str, *, now: datetime) -> list[str]:
    keys = list(session.scalars(select(UploadPart.blob_key).where(UploadPart.upload_id == upload_id)))
    changed(session, delete(UploadPart).where(UploadPart.upload_id == upload_id))
    tombstones.bury(session, keys, now=now)
    return keys
