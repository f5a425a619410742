"""Uploaded videos and references: looked up by content, vectorised once, deleted with all that came from them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal, cast

from sqlalchemy import or_, select, update
from sqlalchemy.orm import Session

from service.catalog import jobs
from service.catalog.database import changed
from service.catalog.models import ACTIVE, Job, JobKind, Look, Media, MediaState, Result, Role
from service.catalog.requests import DEFAULT_VECTOR_SETTINGS, Mask, Matching, VectorizeRequest, VectorSettings
from service.catalog.transitions import Lease, MediaStep, take_media_step


@dataclass(frozen=True)
class Upload:
    """A received file whose bytes are in the storage under ``source_key``."""

    media_id: str
    role: Role
    sha256: str
    size_bytes: int
    content_type: str
    filename: str | None
    source_key: str
    settings: VectorSettings = DEFAULT_VECTOR_SETTINGS


@dataclass(frozen=True)
class Asset:
    """What the vectoriser made of a medium. The asset's bytes are in the storage under ``key``."""

    key: str
    size_bytes: int
    info: dict[str, Any]
    faces: list[dict[str, Any]]
    warnings: list[str]


def get(session: Session, media_id: str, *, lock: Literal["share", "update"] | None = None) -> Media | None:
    """The medium, or None. A lock keeps others from deleting it ("share"), or from using it ("update")."""
    return session.get(Media, media_id, with_for_update={"read": lock == "share"} if lock else None)


def find_content(
    session: Session, role: Role, sha256: str, settings: VectorSettings, *, lock: bool = False
) -> Media | None:
    """The medium of this role with these bytes, vectorised with these settings, or None.

    ``lock`` keeps it as it is until the transaction ends.
    """
    same = (Media.mask == settings.mask, Media.matching == settings.matching)
    query = select(Media).where(Media.role == role, Media.sha256 == sha256, *same)
    return session.scalar(query.with_for_update() if lock else query)


def settings_of(media: Media) -> VectorSettings:
    """How a medium is vectorised."""
    return VectorSettings(cast(Mask, media.mask), cast(Matching, media.matching))


def page(session: Session, role: Role, *, before: str | None, limit: int) -> list[Media]:
    """Media of a role, newest first, older than the id ``before``; ids sort by creation."""
    query = select(Media).where(Media.role == role).order_by(Media.id.desc()).limit(limit)
    if before is not None:
        query = query.where(Media.id < before)
    return list(session.scalars(query))


def create(session: Session, upload: Upload, *, now: datetime, ttl_s: float) -> Media:
    """Record a new medium with the job that vectorises it.

    Raises `sqlalchemy.exc.IntegrityError` at flush when another request recorded the same content first.
    """
    request = VectorizeRequest(upload.role, upload.settings)
    job = jobs.create(session, JobKind.VECTORIZE, request=request, now=now, media_id=upload.media_id)
    media = Media(
        id=upload.media_id,
        role=upload.role,
        mask=upload.settings.mask,
        matching=upload.settings.matching,
        state=MediaState.VECTORIZING,
        sha256=upload.sha256,
        size_bytes=upload.size_bytes,
        content_type=upload.content_type,
        filename=upload.filename,
        job_id=job.id,
        source_key=upload.source_key,
        faces=[],
        warnings=[],
        created_at=now,
        updated_at=now,
        expires_at=now + timedelta(seconds=ttl_s),
    )
    session.add(media)
    session.flush()
    return media


def vectorize_again(session: Session, media: Media, *, now: datetime) -> bool:
    """Start over with a medium whose vectorisation failed: the cause may have been ours.

    False, and nothing changed, when the medium is not a failed one. The object is as it was until it is refreshed.
    """
    if media.state != MediaState.FAILED:
        return False
    request = VectorizeRequest(Role(media.role), settings_of(media))
    job = jobs.create(session, JobKind.VECTORIZE, request=request, now=now, media_id=media.id)
    return take_media_step(
        session, MediaStep.VECTORIZE_AGAIN, media.job_id, now=now, values={"error": None, "job_id": job.id}
    )


def keep(session: Session, media_ids: Collection[str], *, now: datetime, ttl_s: float) -> None:
    """Count the retention of these media from now: they are in use."""
    changed(
        session,
        update(Media).where(Media.id.in_(media_ids)).values(expires_at=now + timedelta(seconds=ttl_s)),
    )


def finish(session: Session, lease: Lease, asset: Asset, *, now: datetime, timings: dict[str, Any]) -> list[str] | None:
    """End a vectorising job with its asset, in one step.

    Returns the keys of blobs that are no longer needed, or None when the lease is lost and nothing was changed.
    """
    if not jobs.succeed(session, lease, now=now, timings=timings):
        return None
    replaced = session.scalar(select(Media.asset_key).where(Media.job_id == lease.job_id).with_for_update())
    values = {
        "asset_key": asset.key,
        "asset_bytes": asset.size_bytes,
        "info": asset.info,
        "faces": list(asset.faces),
        "warnings": list(asset.warnings),
        "error": None,
    }
    finished = take_media_step(session, MediaStep.FINISH, lease.job_id, now=now, values=values)
    if not finished:  # deleted: its job was canceled, so the lease is lost; kept for a half-done delete
        return [asset.key]
    return [replaced] if replaced else []


def active_jobs(session: Session, media_id: str) -> list[str]:
    """Ids of the unfinished jobs that need this medium."""
    users = select(Look.job_id).where(or_(Look.video_id == media_id, Look.reference_id == media_id))
    query = select(Job.id).where(Job.state.in_(ACTIVE), or_(Job.media_id == media_id, Job.id.in_(users)))
    return list(session.scalars(query))


def delete(session: Session, media: Media) -> list[str]:
    """Remove a medium and every result made with it. Returns the keys of the blobs to delete after the commit."""
    results: Sequence[Result] = session.scalars(
        select(Result).where(or_(Result.video_id == media.id, Result.reference_id == media.id))
    ).all()
    keys = [key for result in results if (key := result.blob_key)]
    keys += [key for key in (media.asset_key, media.source_key) if key]
    gone = [result.id for result in results]
    changed(session, update(Look).where(Look.result_id.in_(gone)).values(result_id=None))
    for result in results:
        session.delete(result)
    session.delete(media)
    session.flush()
    return keys
