"""What each owner has had done, by month: counted by the transaction that does it, and never less afterwards.

A month is one of UTC, such as "2026-11". A job counts when it ends, in the month of its end, and once however many
attempts and parts it takes; its looks count when it succeeds; a file counts when it becomes a medium. What is deleted,
expires, or is given to another owner stays counted where it was made.

Each owner has one row a month. What a transaction counts is added to it right before the commit, when all of its other
locks are had, and rows in one order: nobody who has one waits for anything else, so that none waits in a circle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from typing import Final, cast

from sqlalchemy import Executable, Table, bindparam, delete, func, select, tuple_
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from service.catalog.database import at_last, changed
from service.catalog.models import ENDED, Job, JobState, Look, Media, MonthlyUsage

#: what a transaction has counted, in `Session.info`
_COUNTED: Final = "ledger"
_TABLE: Final = cast("Table", MonthlyUsage.__table__)
_NOTHING: Final = {column.name: 0 for column in _TABLE.c if not column.primary_key}
_Counted = dict[tuple[str, str], Counter[str]]

#: the owner of a job that clients asked for, how many looks it has, and what their videos have of frames and seconds
_OF_JOB: Final = (
    select(
        Job.owner,
        func.count(Look.position).label("looks"),
        func.coalesce(func.sum(Media.info["frame_count"].as_integer()), 0).label("frames"),
        func.coalesce(func.sum(Media.info["duration_s"].as_float()), 0.0).label("duration_s"),
    )
    .outerjoin(Look, Look.job_id == Job.id)
    .outerjoin(Media, Media.id == Look.video_id)
    .where(Job.id == bindparam("id"), Job.parent_id.is_(None))
    .group_by(Job.owner)
)


@dataclass(frozen=True)
class Month:
    """What an owner has had done in a month."""

    month: str
    #: jobs that ended, by state; none of those of which there are none
    jobs: Mapping[str, int]
    #: of jobs that succeeded, and the frames and the seconds of the videos they are of: of each look all of them
    looks: int
    frames: int
    duration_s: float
    #: files that became media, and their bytes
    uploads: int
    upload_bytes: int


def month_of(time: datetime) -> str:
    """The month that a time is in."""
    return f"{time.astimezone(UTC):%Y-%m}"


def count_job(session: Session, job_id: str, state: JobState, *, now: datetime) -> None:
    """Count a job that ends in this transaction, in this state, with what it has made; shares of jobs are none."""
    found = session.execute(_OF_JOB, {"id": job_id}).one_or_none()
    if found is None:
        return
    made = {"looks": found.looks, "frames": found.frames, "milliseconds": round(1000 * found.duration_s)}
    _count(session, found.owner, now, {state.value: 1} | (made if state is JobState.SUCCEEDED else {}))


def count_upload(session: Session, owner: str, size_bytes: int, *, now: datetime) -> None:
    """Count a file that becomes a medium in this transaction."""
    _count(session, owner, now, {"uploads": 1, "upload_bytes": size_bytes})


def _count(session: Session, owner: str, now: datetime, more: Mapping[str, int]) -> None:
    counted: _Counted = session.info.setdefault(_COUNTED, {})
    counted.setdefault((owner, month_of(now)), Counter()).update(more)
    at_last(session, _write)


def _write(session: Session) -> None:
    """Add what the transaction has counted to the months of its owners."""
    counted: _Counted = session.info.pop(_COUNTED, {})
    add = _adding(session.get_bind().dialect.name)
    for (owner, month), more in sorted(counted.items()):
        session.execute(add, {**_NOTHING, **more, "owner": owner, "month": month})


@cache
def _adding(dialect: str) -> Executable:
    """The statement that adds to a row, or makes it."""
    insert = postgresql.insert if dialect == "postgresql" else sqlite.insert
    added = insert(_TABLE).values({column.name: bindparam(column.name) for column in _TABLE.c})
    sums = {name: _TABLE.c[name] + added.excluded[name] for name in _NOTHING}
    return added.on_conflict_do_update(index_elements=[_TABLE.c.owner, _TABLE.c.month], set_=sums)


def months(session: Session, owner: str, *, now: datetime) -> list[Month]:
    """The months of an owner that are kept, the present one first, which is there in any case."""
    present = month_of(now)
    mine = (MonthlyUsage.owner == owner, MonthlyUsage.month <= present)
    rows = session.scalars(select(MonthlyUsage).where(*mine).order_by(MonthlyUsage.month.desc()))
    found = [_month(row) for row in rows]
    if not found or found[0].month != present:
        found.insert(0, Month(present, {}, 0, 0, 0.0, 0, 0))
    return found


def every(session: Session, *, month: str | None = None) -> list[tuple[str, Month]]:
    """The months of all owners, or one month, the oldest first."""
    query = select(MonthlyUsage).order_by(MonthlyUsage.month, MonthlyUsage.owner)
    chosen = query if month is None else query.where(MonthlyUsage.month == month)
    return [(row.owner, _month(row)) for row in session.scalars(chosen)]


def _month(row: MonthlyUsage) -> Month:
    by_state = {state.value: getattr(row, state.value) for state in ENDED}
    return Month(
        month=row.month,
        jobs={state: count for state, count in by_state.items() if count},
        looks=row.looks,
        frames=row.frames,
        duration_s=row.milliseconds / 1000,
        uploads=row.uploads,
        upload_bytes=row.upload_bytes,
    )


def expire(session: Session, *, now: datetime, keep_months: int, limit: int) -> int:
    """Remove the months before the last ``keep_months``, with the present one, at most ``limit``. Returns their number.

    The last step of its transaction: see above.
    """
    row = MonthlyUsage
    late = select(row.owner, row.month).where(row.month < _first_kept(now, keep_months))
    late = late.order_by(row.owner, row.month).limit(limit).with_for_update(skip_locked=True)
    gone = [tuple(found) for found in session.execute(late)]
    return changed(session, delete(row).where(tuple_(row.owner, row.month).in_(gone))) if gone else 0


def _first_kept(now: datetime, keep_months: int) -> str:
    present = now.astimezone(UTC)
    year, before = divmod(12 * present.year + present.month - keep_months, 12)
    return f"{year:04d}-{before + 1:02d}"
