"""Single pictures that are asked for and waited for: frames of a look, and layers of a frame.

A picture is kept for some seconds, for those who ask for the same, and is no result: its blob is never recorded as one,
so that its tombstone ends it. A request that nobody has begun in time is dropped, not done later.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Final

from sqlalchemy import and_, delete, func, or_, select, update
from sqlalchemy.orm import Session

from service.catalog.database import changed
from service.catalog.models import Preview, PreviewState
from service.catalog.requests import StillRequest, to_json
from service.ids import new_id

#: seconds for which a picture is kept, until the reaper's next round
KEPT_S: Final = 30.0
#: its record outlives it, so that whoever deletes its medium finds it, and those who wait for it: `preview_timeout_s`
#: is not longer
_RECORDED_S: Final = 60.0
#: of those, for how long it is given to others: who is told of it late finds it still
_SHARED_S: Final = 20.0
_OPEN: Final = (PreviewState.ASKED, PreviewState.TAKEN)


@dataclass(frozen=True)
class Still:
    """A picture that was made: its bytes are in the storage under ``key``."""

    key: str
    size_bytes: int
    frame: int


def ask(
    session: Session,
    request: StillRequest,
    *,
    owner: str,
    media_id: str,
    reference_id: str | None,
    fingerprint: str,
    now: datetime,
    within_s: float,
) -> tuple[Preview, bool]:
    """The owner's request for this picture, and whether it is new and has to be sent to a worker.

    One that was not made ``within_s`` is not waited for: nobody begins it any more, or its worker is gone.
    """
    is_shared = or_(
        and_(Preview.state == PreviewState.DONE, Preview.created_at > now - timedelta(seconds=_SHARED_S)),
        and_(Preview.state.in_(_OPEN), Preview.created_at > now - timedelta(seconds=within_s)),
    )
    alike = (Preview.owner == owner, Preview.fingerprint == fingerprint)
    _take_turns(session, owner)
    query = select(Preview).where(*alike, is_shared).order_by(Preview.id.desc()).limit(1)
    if (known := session.scalar(query)) is not None:
        return known, False
    preview = Preview(
        id=new_id("prv"),
        owner=owner,
        media_id=media_id,
        reference_id=reference_id,
        fingerprint=fingerprint,
        state=PreviewState.ASKED,
        request=to_json(request),
        created_at=now,
    )
    session.add(preview)
    session.flush()
    return preview, True


def _take_turns(session: Session, owner: str) -> None:
    """Until the end of the transaction no other request of the owner is recorded: the next one finds and counts this.

    SQLite has one writer at a time anyway.
    """
    if session.get_bind().dialect.name == "postgresql":
        session.execute(select(func.pg_advisory_xact_lock(func.hashtext(f"previews of {owner}"))))


def open_count(session: Session, owner: str, *, now: datetime, within_s: float) -> int:
    """How many of an owner's pictures are not made yet; ``within_s`` seconds somebody waits for each."""
    since = now - timedelta(seconds=max(KEPT_S, within_s))
    mine = (Preview.owner == owner, Preview.state.in_(_OPEN), Preview.created_at > since)
    return session.scalar(select(func.count()).select_from(Preview).where(*mine)) or 0


def waiting(session: Session, *, now: datetime, within_s: float) -> list[Preview]:
    """The requests that a worker may begin, oldest first."""
    since = now - timedelta(seconds=within_s)
    query = select(Preview).where(Preview.state == PreviewState.ASKED, Preview.created_at > since)
    return list(session.scalars(query.order_by(Preview.id)))


def take(session: Session, preview_id: str, *, now: datetime, within_s: float) -> Preview | None:
    """Begin to make a picture. None when it was taken, dropped, or asked for so long ago that nobody waits for it."""
    since = now - timedelta(seconds=within_s)
    mine = (Preview.id == preview_id, Preview.state == PreviewState.ASKED, Preview.created_at > since)
    if not changed(session, update(Preview).where(*mine).values(state=PreviewState.TAKEN)):
        return None
    return session.get(Preview, preview_id)


def finish(session: Session, preview_id: str, still: Still) -> bool:
    """Say where the picture is. False when its medium was deleted meanwhile: then its bytes have to go."""
    values = {"blob_key": still.key, "size_bytes": still.size_bytes, "frame": still.frame}
    return _end(session, preview_id, PreviewState.DONE, values)


def fail(session: Session, preview_id: str, error: dict[str, Any]) -> bool:
    """Say why there is no picture."""
    return _end(session, preview_id, PreviewState.FAILED, {"error": error})


def _end(session: Session, preview_id: str, state: PreviewState, values: dict[str, Any]) -> bool:
    mine = (Preview.id == preview_id, Preview.state == PreviewState.TAKEN)
    return changed(session, update(Preview).where(*mine).values(state=state, **values)) == 1


def ended(session: Session, preview_ids: Collection[str]) -> list[Preview]:
    """Those of the pictures that are made, or cannot be."""
    return list(session.scalars(select(Preview).where(Preview.id.in_(preview_ids), Preview.state.not_in(_OPEN))))


def existing(session: Session, preview_ids: Collection[str]) -> set[str]:
    """Those of the requests that are still there."""
    return set(session.scalars(select(Preview.id).where(Preview.id.in_(preview_ids))))


def drop(session: Session, preview_id: str) -> None:
    """Forget a request that nobody waits for any more and that no worker has begun."""
    changed(session, delete(Preview).where(Preview.id == preview_id, Preview.state == PreviewState.ASKED))


def delete_of(session: Session, media_id: str) -> list[str]:
    """Remove all pictures of a medium. Returns the keys of their blobs, to be buried."""
    theirs = or_(Preview.media_id == media_id, Preview.reference_id == media_id)
    keys = [key for key in session.scalars(select(Preview.blob_key).where(theirs)) if key]
    changed(session, delete(Preview).where(theirs))
    return keys


def expire(session: Session, *, now: datetime) -> int:
    """Remove the records of pictures that are no longer kept. Returns their number."""
    return changed(session, delete(Preview).where(Preview.created_at < now - timedelta(seconds=_RECORDED_S)))
