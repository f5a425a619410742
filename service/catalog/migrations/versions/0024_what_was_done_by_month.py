"""what each owner has had done by month, as far as there are records of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None

_STATES = ("succeeded", "failed", "canceled", "expired")
_COUNTS = (*_STATES, "looks", "frames", "milliseconds", "uploads", "upload_bytes")

_JOBS = sa.table("jobs", *map(sa.column, ("id", "owner", "parent_id", "state", "finished_at")))
_LOOKS = sa.table("looks", sa.column("job_id"), sa.column("video_id"))
_MEDIA = sa.table("media", *map(sa.column, ("id", "owner", "size_bytes", "created_at")), sa.column("info", sa.JSON()))


def upgrade() -> None:
    table = op.create_table(
        "monthly_usage",
        sa.Column("owner", sa.String(length=40), nullable=False),
        sa.Column("month", sa.String(length=7), nullable=False),
        *(sa.Column(name, sa.BigInteger(), nullable=False) for name in _COUNTS),
        sa.PrimaryKeyConstraint("owner", "month", name=op.f("pk_monthly_usage")),
    )
    found = sa.union_all(_jobs(), _looks(), _uploads()).subquery()
    sums = (sa.cast(sa.func.sum(found.c[name]), sa.BigInteger()) for name in _COUNTS)
    by_month = sa.select(found.c.owner, found.c.month, *sums).group_by(found.c.owner, found.c.month)
    op.execute(sa.insert(table).from_select(["owner", "month", *_COUNTS], by_month))


def downgrade() -> None:
    op.drop_table("monthly_usage")


def _jobs() -> sa.Select[Any]:
    """One of each job that has ended and that clients asked for."""
    ended = (_JOBS.c.parent_id.is_(None), _JOBS.c.state.in_(_STATES), _JOBS.c.finished_at.is_not(None))
    ones = {state: sa.case((_JOBS.c.state == state, 1), else_=0) for state in _STATES}
    return _counted(_JOBS.c.owner, _JOBS.c.finished_at, ones).where(*ended)


def _looks() -> sa.Select[Any]:
    """One of each look of those that succeeded. What its video has is known while that is there."""
    done = (_JOBS.c.parent_id.is_(None), _JOBS.c.state == "succeeded", _JOBS.c.finished_at.is_not(None))
    made = {
        "looks": sa.literal(1),
        "frames": sa.func.coalesce(_MEDIA.c.info["frame_count"].as_integer(), 0),
        "milliseconds": sa.func.coalesce(sa.func.round(1000 * _MEDIA.c.info["duration_s"].as_float()), 0),
    }
    with_video = _LOOKS.join(_JOBS, _JOBS.c.id == _LOOKS.c.job_id).outerjoin(_MEDIA, _MEDIA.c.id == _LOOKS.c.video_id)
    return _counted(_JOBS.c.owner, _JOBS.c.finished_at, made).select_from(with_video).where(*done)


def _uploads() -> sa.Select[Any]:
    """One of each medium."""
    return _counted(
        _MEDIA.c.owner, _MEDIA.c.created_at, {"uploads": sa.literal(1), "upload_bytes": _MEDIA.c.size_bytes}
    )


def _counted(
    owner: sa.ColumnElement[Any], time: sa.ColumnElement[Any], counts: Mapping[str, sa.ColumnElement[Any]]
) -> sa.Select[Any]:
    columns = (counts.get(name, sa.literal(0)).label(name) for name in _COUNTS)
    return sa.select(owner.label("owner"), _month(time).label("month"), *columns)


def _month(time: sa.ColumnElement[Any]) -> sa.ColumnElement[Any]:
    """Of UTC, which SQLite has all times in."""
    if op.get_bind().dialect.name == "sqlite":
        return sa.func.strftime("%Y-%m", time)
    return sa.func.to_char(sa.func.timezone("UTC", time), "YYYY-MM")
