"""Finished outputs: recorded together with their job's end, deleted after their retention."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Any, Literal

from sqlalchemy import delete as delete_rows
from sqlalchemy import or_, select, update
from sqlalchemy.orm import Session

from service.catalog import idempotency, jobs, leases, tombstones
from service.catalog.database import changed
from service.catalog.models import Job, Look, Media, Result
from service.catalog.parts import whole_of
from service.catalog.transitions import Lease

#: what is made beside a result, by the last part of its address
PartName = Literal["look.cube", "matte"]


@dataclass(frozen=True)
class Report:
    """What is to be known of a drawn look: how its video was vectorised, and what may spoil it."""

    mask: str
    matching: str
    input_color: str = "auto"
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class PartOf:
    """What a part of a result is: which of its parts, of which of the persons that the look changes, from 1."""

    result_id: str
    part: PartName
    person: int


@dataclass(frozen=True)
class Output:
    """A rendered file whose bytes are in the storage under ``key``. ``position`` is that of its look."""

    result_id: str
    position: int
    key: str
    sha256: str
    size_bytes: int
    content_type: str
    filename: str
    report: Report | None = None
    part_of: PartOf | None = None


def get(session: Session, result_id: str, *, owner: str | None = None) -> Result | None:
    """The result, or None; with an ``owner``, None for another's too. Parts of one are found by `parts`.

    Its ``blob_key`` is None once the bytes are removed.
    """
    result = session.get(Result, result_id)
    if result is None or result.part_of is not None or owner not in {None, result.owner}:
        return None
    return result


def files(session: Session, result_ids: Collection[str]) -> list[Result]:
    """These results and what was made beside them, the latter by part, then by person."""
    if not result_ids:
        return []
    query = select(Result).where(or_(Result.id.in_(result_ids), Result.part_of.in_(result_ids)))
    return list(session.scalars(query.order_by(Result.part, Result.person)))


def parts(session: Session, result_ids: Collection[str]) -> list[Result]:
    """What was made beside these results: by part, then by person."""
    if not result_ids:
        return []
    query = select(Result).where(Result.part_of.in_(result_ids)).order_by(Result.part, Result.person)
    return list(session.scalars(query))


def keys_of(session: Session, job_id: str) -> list[str]:
    """The blobs of a job's results, and of what was made beside them."""
    return list(session.scalars(select(Result.blob_key).where(Result.job_id == job_id, Result.blob_key.is_not(None))))


def kept_until(session: Session, found: Sequence[Result]) -> dict[str, datetime]:
    """Until when each of these results and parts is kept, by its id: it goes with its video and its reference."""
    if not found:
        return {}
    ids = {media_id for result in found for media_id in (result.video_id, result.reference_id)}
    rows = session.execute(select(Media.id, Media.expires_at).where(Media.id.in_(ids)))
    of_media = {row.id: row.expires_at for row in rows}
    # a medium that is deleted just now limits nothing: its results were read before they went with it
    return {
        result.id: min(
            result.expires_at,
            *(of_media.get(media_id, result.expires_at) for media_id in (result.video_id, result.reference_id)),
        )
        for result in found
    }


def publish(
    session: Session,
    lease: Lease,
    outputs: Sequence[Output],
    *,
    now: datetime,
    timings: dict[str, Any],
    ttl_s: float,
) -> bool:
    """End a rendering job with its results, in one step; with a join, the job whose parts it has joined.

    False when the lease is lost: nothing was changed. Raises `LateError` when a file took so long to be written that it
    is deleted.
    """
    job_id = whole_of(session, lease.job_id) or lease.job_id
    if not leases.succeed(session, lease, now=now, timings=timings):
        return False
    if not tombstones.recorded(session, [output.key for output in outputs]):
        raise tombstones.LateError(job_id)
    owner = session.scalar(select(Job.owner).where(Job.id == job_id)) or ""
    wanted = {look.position: look for look in jobs.looks(session, job_id)}
    for output in outputs:
        look, part = wanted[output.position], output.part_of
        if part is None:
            look.result_id = output.result_id
            look.report = (
                None if output.report is None else {**asdict(output.report), "warnings": list(output.report.warnings)}
            )
        session.add(
            Result(
                id=output.result_id,
                owner=owner,
                job_id=job_id,
                position=output.position,
                video_id=look.video_id,
                reference_id=look.reference_id,
                blob_key=output.key,
                sha256=output.sha256,
                size_bytes=output.size_bytes,
                content_type=output.content_type,
                filename=output.filename,
                created_at=now,
                expires_at=now + timedelta(seconds=ttl_s),
                part_of=None if part is None else part.result_id,
                part=None if part is None else part.part,
                person=None if part is None else part.person,
            )
        )
    session.flush()
    return True


def keep(session: Session, job_id: str, *, now: datetime, ttl_s: float) -> bool:
    """Count the retention of a job's results, if there are any yet, from now, unless it is longer: they are asked for.

    False, and nothing changed, when one of them has expired or was deleted meanwhile.
    """
    of_job = Result.job_id == job_id
    # whoever drops or deletes them is waited for; of what is deleted, the look alone tells
    blobs = session.scalars(select(Result.blob_key).where(of_job).order_by(Result.id).with_for_update()).all()
    gone = select(Look.position).where(Look.job_id == job_id, Look.result_gone.is_not(None)).limit(1)
    if None in blobs or session.scalar(gone) is not None:
        return False
    longer = now + timedelta(seconds=ttl_s)
    changed(session, update(Result).where(of_job, Result.expires_at < longer).values(expires_at=longer))
    return True


def drop_bytes(session: Session, result: Result, *, now: datetime) -> str | None:
    """Forget the bytes of a result whose look is locked. Returns the blob's key, to be deleted after the commit.

    Its tombstone is written by the same transaction.
    """
    key = result.blob_key
    if key is None:
        return None
    dropped = changed(
        session, update(Result).where(Result.id == result.id, Result.blob_key == key).values(blob_key=None)
    )
    changed(session, update(Look).where(Look.result_id == result.id).values(result_id=None, result_gone="expired"))
    if not dropped:
        return None
    tombstones.bury(session, [key], now=now)
    return key


def delete(session: Session, result_id: str, *, now: datetime) -> list[str]:
    """Remove a result with what was made beside it. Returns the keys of the blobs to delete after the commit.

    Their tombstones are written by the same transaction.
    """
    # its only look, before it, see `jobs.lock_looks`
    changed(session, update(Look).where(Look.result_id == result_id).values(result_id=None, result_gone="deleted"))
    its = or_(Result.id == result_id, Result.part_of == result_id)
    found = session.scalars(select(Result.blob_key).where(its).order_by(Result.id).with_for_update())
    keys = [key for key in found if key]
    idempotency.forget(session, [result_id])
    changed(session, delete_rows(Result).where(its))
    tombstones.bury(session, keys, now=now)
    return keys
