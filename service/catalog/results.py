"""Finished outputs: recorded together with their job's end, deleted after their retention."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import update
from sqlalchemy.orm import Session

from service.catalog import jobs
from service.catalog.database import changed
from service.catalog.models import Look, Result
from service.catalog.transitions import Lease


@dataclass(frozen=True)
class Report:
    """What is to be known of a drawn look: how its video was vectorised, and what may spoil it."""

    mask: str
    matching: str
    warnings: tuple[str, ...] = ()


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


def get(session: Session, result_id: str) -> Result | None:
    """The result, or None. Its ``blob_key`` is None once the bytes are removed."""
    return session.get(Result, result_id)


def publish(
    session: Session,
    lease: Lease,
    outputs: Sequence[Output],
    *,
    now: datetime,
    timings: dict[str, Any],
    ttl_s: float,
) -> bool:
    """End a rendering job with its results, in one step. False when the lease is lost: nothing was changed."""
    if not jobs.succeed(session, lease, now=now, timings=timings):
        return False
    wanted = {look.position: look for look in jobs.looks(session, lease.job_id)}
    for output in outputs:
        look = wanted[output.position]
        look.result_id = output.result_id
        look.report = (
            None if output.report is None else {**asdict(output.report), "warnings": list(output.report.warnings)}
        )
        session.add(
            Result(
                id=output.result_id,
                job_id=lease.job_id,
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
            )
        )
    session.flush()
    return True


def drop_bytes(session: Session, result: Result) -> str | None:
    """Forget the bytes of a result. Returns the blob's key, to be deleted after the commit."""
    key = result.blob_key
    if key is None:
        return None
    dropped = changed(
        session, update(Result).where(Result.id == result.id, Result.blob_key == key).values(blob_key=None)
    )
    changed(session, update(Look).where(Look.result_id == result.id).values(result_id=None))
    return key if dropped else None
