"""Uploaded videos and references: looked up by content, vectorised once, deleted with all that came from them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime, timedelta
from types import MappingProxyType
from typing import Any, Final, Literal

from sqlalchemy import case, or_, select, union_all, update
from sqlalchemy import delete as delete_rows
from sqlalchemy.orm import Session

from service.catalog import idempotency, jobs, leases, ledger, parts, previews, resumable, tombstones
from service.catalog.database import changed
from service.catalog.messages import Message
from service.catalog.models import ACTIVE, Job, JobKind, JobState, Look, Media, MediaState, Result, Role
from service.catalog.paging import newest
from service.catalog.requests import DEFAULT_VECTOR_SETTINGS, VectorizeRequest, VectorSettings, vector_settings
from service.catalog.retention import is_kept
from service.catalog.transitions import Lease, MediaStep, take_media_step

#: the least that a time is moved by
_TICK: Final = timedelta(microseconds=1)


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
    owner: str = ""
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Asset:
    """What the vectoriser made of a medium. The asset's bytes are in the storage under ``key``.

    ``size_bytes`` counts its small pictures too.
    """

    key: str
    size_bytes: int
    info: dict[str, Any]
    faces: list[dict[str, Any]]
    warnings: list[str]
    pictures: Pictures | None = None

    @property
    def keys(self) -> list[str]:
        """Of all its blobs."""
        return [self.key] if self.pictures is None else [self.key, self.pictures.key]


@dataclass(frozen=True)
class Pictures:
    """Small pictures of a medium, JPEG, one after the other in the blob ``key``.

    spans: ``[face, start, end]`` of each, in bytes; the poster's face is None.
    """

    key: str
    spans: list[list[int | None]]


def picture_of(medium: Media, face: int | None) -> tuple[str, int, int] | None:
    """The blob, and the bytes [start, end) in it, of a medium's poster, or of a face's thumbnail; None without one."""
    for of, start, end in medium.pictures or ():
        if of == face and medium.pictures_key is not None:
            return medium.pictures_key, start, end
    return None


def get(
    session: Session, media_id: str, *, owner: str | None = None, lock: Literal["share", "update"] | None = None
) -> Media | None:
    """The medium, or None; with an ``owner``, None for another's too.

    A lock keeps others from deleting it ("share"), or from using it ("update").
    """
    found = session.get(Media, media_id, with_for_update={"read": lock == "share"} if lock else None)
    return found if found is not None and owner in {None, found.owner} else None


def assets(session: Session, media_ids: Collection[str]) -> dict[str, str | None]:
    """The asset's blob of each of these media that is there, by its id."""
    found = session.execute(select(Media.id, Media.asset_key).where(Media.id.in_(media_ids)))
    return {row.id: row.asset_key for row in found}


def several(session: Session, owner: str, media_ids: Collection[str], *, lock: bool = False) -> dict[str, Media]:
    """Those of these media of an owner that there are, by id.

    With ``lock`` others are kept from using or deleting them: all at once, in one order, so that none waits for one
    who waits for it.
    """
    query = select(Media).where(Media.owner == owner, Media.id.in_(media_ids)).order_by(Media.id)
    return {one.id: one for one in session.scalars(query.with_for_update() if lock else query)}


def locked(session: Session, media_ids: Collection[str]) -> list[Media]:
    """Those of these media that there are, kept from others: in the order of their ids, as by all who lock several."""
    found = [get(session, media_id, lock="update") for media_id in sorted(media_ids)]
    return [one for one in found if one is not None]


def find_content(
    session: Session, role: Role, sha256: str, settings: VectorSettings, *, owner: str = "", lock: bool = False
) -> Media | None:
    """The owner's medium of this role with these bytes, vectorised with these settings, or None.

    ``lock`` keeps it as it is until the transaction ends.
    """
    same = (getattr(Media, name) == value for name, value in asdict(settings).items())
    query = select(Media).where(Media.owner == owner, Media.role == role, Media.sha256 == sha256, *same)
    return session.scalar(query.with_for_update() if lock else query)


def page(
    session: Session,
    role: Role,
    *,
    owner: str,
    states: Collection[str] = (),
    metadata: Mapping[str, str] = MappingProxyType({}),
    before: str | None,
    limit: int,
) -> list[Media]:
    """An owner's media of a role, newest first, older than the id ``before``; ids sort by creation.

    In one of these states, if any are named, and with all of this metadata.
    """
    chosen = [Media.owner == owner, Media.role == role]
    if before is not None:
        chosen.append(Media.id < before)
    chosen += [Media.metadata_[name].as_string() == value for name, value in metadata.items()]
    return newest(session, Media, chosen, states, limit=limit)


def create(session: Session, upload: Upload, *, now: datetime, ttl_s: float) -> Media:
    """Record a new medium with the job that vectorises it.

    Raises `sqlalchemy.exc.IntegrityError` at flush when another request recorded the same content first, and
    `LateError` when the blob took so long to be written that it is deleted.
    """
    if not tombstones.recorded(session, [upload.source_key]):
        raise tombstones.LateError(upload.source_key)
    media = Media(
        id=upload.media_id,
        owner=upload.owner,
        metadata_=dict(upload.metadata),
        role=upload.role,
        **asdict(upload.settings),
        state=MediaState.VECTORIZING,
        sha256=upload.sha256,
        size_bytes=upload.size_bytes,
        content_type=upload.content_type,
        filename=upload.filename,
        source_key=upload.source_key,
        faces=[],
        warnings=[],
        created_at=now,
        updated_at=now,
        expires_at=now + timedelta(seconds=ttl_s),
    )
    media.job_id = _job_of(session, media, now=now).id
    session.add(media)
    session.flush()
    ledger.count_upload(session, upload.owner, upload.size_bytes, now=now)
    return media


def replace_source(session: Session, media: Media, key: str, *, now: datetime) -> None:
    """The file of a medium, which was lost, is there again under another key.

    Raises `LateError` when it took so long to be written that it is deleted.
    """
    if not tombstones.recorded(session, [key]):
        raise tombstones.LateError(key)
    tombstones.bury(session, [media.source_key], now=now)
    media.source_key = key


def vectorize_again(session: Session, media: Media, *, now: datetime) -> bool:
    """Start over with a medium whose vectorisation failed: the cause may have been ours.

    False, and nothing changed, when the medium is not a failed one. The object is as it was until it is refreshed.
    """
    if media.state != MediaState.FAILED:
        return False
    job = _job_of(session, media, now=now)
    return take_media_step(
        session, MediaStep.VECTORIZE_AGAIN, media.job_id, now=now, values={"error": None, "job_id": job.id}
    )


def name(session: Session, media: Media, metadata: Mapping[str, str]) -> None:
    """Give a medium new metadata; the job that vectorises it, or has done so, shows the same."""
    media.metadata_ = dict(metadata)
    changed(session, update(Job).where(Job.id == media.job_id).values(metadata_=dict(metadata)))


def _job_of(session: Session, media: Media, *, now: datetime) -> Job:
    """A new job that vectorises a medium."""
    request = VectorizeRequest(Role(media.role), vector_settings(media))
    return jobs.create(
        session,
        JobKind.VECTORIZE,
        request=request,
        now=now,
        media_id=media.id,
        owner=media.owner,
        metadata=media.metadata_,
    )


def make_again(
    session: Session, lease: Lease, assets: Mapping[str, str | None], *, now: datetime
) -> list[Message] | None:
    """Vectorise media again whose assets a running job finds lost or unreadable; the job waits for them.

    ``assets`` are the keys of their blobs as the job found them. One that another job has had made again, or has now,
    is waited for alone. Of a part or a join it is the whole job that waits, and begins anew.

    Returns what is to be published: nothing when the lease is lost. None, and nothing changed, when the asset of one
    was made after the job was created and is unusable all the same: it would be so again.
    """
    job = jobs.get(session, lease.job_id)
    if job is None:
        return []
    asked_at = _asked_at(session, job)
    found = locked(session, assets)
    lost = [one for one in found if one.state == MediaState.READY and one.asset_key == assets[one.id]]
    if any(_made_since(session, one, asked_at) for one in lost):
        return None
    if not leases.wait_again(session, lease, now=now):
        return []
    messages = []
    for one in lost:
        again = _job_of(session, one, now=now)
        take_media_step(session, MediaStep.MAKE_AGAIN, one.job_id, now=now, values={"job_id": again.id})
        messages.append(jobs.message_of(again))
    return messages


def unready(session: Session, job: Job, media: Sequence[Media]) -> set[str]:
    """The ids of those that a job that makes looks has to wait for again.

    They are not ready any more; or, for a part or a join, they were vectorised again since the whole was cut, so that
    other parts may be drawn by other assets.
    """
    made_by = {} if job.parent_id is None else parts.made_by(session, job.parent_id)
    return {one.id for one in media if one.state != MediaState.READY or made_by.get(one.id, one.job_id) != one.job_id}


def made_since_asked(session: Session, job: Job, media: Sequence[Media]) -> set[str]:
    """The ids of those whose assets were made after the job was asked for: for it they are not made again."""
    asked_at = _asked_at(session, job)
    return {one.id for one in media if _made_since(session, one, asked_at)}


def _asked_at(session: Session, job: Job) -> datetime:
    """When a job, or the one it is a part of, was asked for: one that is cut again has younger parts than assets."""
    whole = None if job.parent_id is None else jobs.get(session, job.parent_id)
    return (whole or job).created_at


def _made_since(session: Session, media: Media, then: datetime) -> bool:
    made = jobs.get(session, media.job_id)
    return made is not None and made.state == JobState.SUCCEEDED and made.created_at > then


def keep(media: Iterable[Media], *, now: datetime, ttl_s: float) -> None:
    """Count the retention of these media, which are locked, from now, unless it is longer: they are in use.

    Each use moves it, if by no more than a tick: by that a medium is seen to have been used.
    """
    for one in media:
        one.expires_at = max(one.expires_at + _TICK, now + timedelta(seconds=ttl_s))


def kept_until(session: Session, job_ids: Collection[str]) -> dict[str, datetime]:
    """Until when the media are kept that these jobs have vectorised, and no other since, by the ids of the jobs."""
    if not job_ids:
        return {}
    return dict(iter(session.execute(select(Media.job_id, Media.expires_at).where(Media.job_id.in_(job_ids)))))


def use(media: Iterable[Media], *, now: datetime, ttl_s: float) -> None:
    """Count the retention of these media, which are locked, from now, unless it was lately: a use by the way."""
    keep([one for one in media if not is_kept(one.expires_at, now=now, ttl_s=ttl_s)], now=now, ttl_s=ttl_s)


def finish(session: Session, lease: Lease, asset: Asset, *, now: datetime, timings: dict[str, Any]) -> list[str] | None:
    """End a vectorising job with its asset, in one step.

    Returns the keys of blobs that are no longer needed and have their tombstones, or None when the lease is lost and
    nothing was changed. Raises `LateError` when the asset took so long to be written that it is deleted.
    """
    if not leases.succeed(session, lease, now=now, timings=timings):
        return None
    if not tombstones.recorded(session, asset.keys):
        raise tombstones.LateError(asset.key)
    columns = select(Media.asset_key, Media.pictures_key).where(Media.job_id == lease.job_id)
    replaced = [key for row in session.execute(columns.with_for_update()) for key in row if key]
    values = {
        "asset_key": asset.key,
        "asset_bytes": asset.size_bytes,
        "pictures_key": None if asset.pictures is None else asset.pictures.key,
        "pictures": None if asset.pictures is None else asset.pictures.spans,
        "info": asset.info,
        "faces": list(asset.faces),
        "warnings": list(asset.warnings),
        "error": None,
    }
    finished = take_media_step(session, MediaStep.FINISH, lease.job_id, now=now, values=values)
    # not finished: deleted, and its job was canceled, so the lease is lost; kept for a half-done delete
    unneeded = replaced if finished else asset.keys
    tombstones.bury(session, unneeded, now=now)
    return unneeded


def lock_job(session: Session, media_id: str, *, owner: str | None = None) -> None:
    """Keep others from the job that vectorises a medium, with an ``owner`` if that has it.

    Before the medium itself, as its worker does when it ends, and who sends the same again.
    """
    of = () if owner is None else (Media.owner == owner,)
    its = select(Media.job_id).where(Media.id == media_id, *of).scalar_subquery()
    session.execute(select(Job.id).where(Job.id == its).with_for_update())


def active_jobs(session: Session, media_id: str) -> list[str]:
    """Ids of the unfinished jobs that need this medium."""
    users = select(Look.job_id).where(or_(Look.video_id == media_id, Look.reference_id == media_id))
    query = select(Job.id).where(Job.state.in_(ACTIVE), or_(Job.media_id == media_id, Job.id.in_(users)))
    query = query.order_by(Job.id)  # in which others lock them
    return list(session.scalars(query))


def delete(
    session: Session, media: Media, *, now: datetime, why: Literal["expired", "deleted"] = "deleted"
) -> list[str]:
    """Remove a medium and every result made with it, with what was found in it and told of it.

    Returns the keys of the blobs to delete after the commit. Their tombstones are written by the same transaction.
    """
    keys = [key for key in (media.asset_key, media.pictures_key, media.source_key) if key]
    keys += previews.delete_of(session, media.id)
    theirs = or_(Result.video_id == media.id, Result.reference_id == media.id)
    gone = select(Result.id).where(theirs)  # they may be more than a statement has parameters
    # a job that vectorises it shows the metadata of the medium, and outlives it
    changed(session, update(Job).where(Job.media_id == media.id).values(metadata_={}))
    drawn = or_(Look.video_id == media.id, Look.reference_id == media.id)
    jobs.lock_looks(session, drawn)
    # all at once: a server that changes a row twice in a transaction locks what it refers to, the job, after it
    had_result = case((Look.result_id.is_not(None), why), else_=Look.result_gone)
    changed(session, update(Look).where(drawn).values(report=None, result_id=None, result_gone=had_result))
    of_jobs = union_all(select(Look.job_id).where(drawn), select(Job.id).where(Job.media_id == media.id))
    for told in ([media.id], gone, of_jobs):
        idempotency.forget(session, told)
    resumable.forget(session, media.id)
    blobs = session.scalars(select(Result.blob_key).where(theirs).order_by(Result.id).with_for_update())
    keys += [key for key in blobs if key]
    changed(session, delete_rows(Result).where(theirs))
    session.delete(media)
    session.flush()
    tombstones.bury(session, keys, now=now)
    return keys
