"""How much an owner has: unfinished jobs, stored bytes, and when the first of those go."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Final

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from service.catalog.models import ACTIVE, Job, Media, PartFile, Result, ResumableUpload, UploadPart

#: what a piece of a file takes on a disk at least
PIECE_BYTES: Final = 4096


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
