"""The tables. Nothing here is of one database engine only."""

from __future__ import annotations

from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Final

from sqlalchemy import (
    JSON,
    BigInteger,
    DateTime,
    Dialect,
    ForeignKey,
    Index,
    MetaData,
    String,
    TypeDecorator,
    UniqueConstraint,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column


class Role(StrEnum):
    """What a medium was uploaded for. A video may serve as a reference too; not the other way round."""

    VIDEO = "video"
    REFERENCE = "reference"


class MediaState(StrEnum):
    """Where a medium stands; `service.catalog.transitions` has the steps."""

    VECTORIZING = "vectorizing"  # -> ready, failed
    READY = "ready"
    FAILED = "failed"  # -> vectorizing


class JobKind(StrEnum):
    """What a job does."""

    VECTORIZE = "vectorize"
    TRANSFER = "transfer"
    SWAP = "swap"


class JobState(StrEnum):
    """Where a job stands; `service.catalog.transitions` has the steps."""

    QUEUED = "queued"  # -> queued (its media are ready), running, failed, canceled, expired
    RUNNING = "running"  # -> queued (next attempt), canceling, succeeded, failed, canceled
    CANCELING = "canceling"  # -> canceled
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELED = "canceled"
    EXPIRED = "expired"


HELD: Final = (JobState.RUNNING, JobState.CANCELING)
ACTIVE: Final = (JobState.QUEUED, *HELD)
ENDED: Final = (JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED, JobState.EXPIRED)


class UtcDateTime(TypeDecorator[datetime]):
    """Aware UTC times on every engine; SQLite itself forgets the zone."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """To the database: always UTC; naive for SQLite, so that its text compares in time order."""
        if value is None:
            return None
        value = value.astimezone(UTC)
        return value.replace(tzinfo=None) if dialect.name == "sqlite" else value

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """From the database: always aware."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Base(DeclarativeBase):
    """Base of the tables, with names for every constraint so that migrations can address them."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy reads it from the class
        datetime: UtcDateTime(),
        dict[str, Any]: JSON(none_as_null=True),
        list[Any]: JSON(none_as_null=True),
    }


class Media(Base):
    """An uploaded video or reference, and its asset once vectorised."""

    __tablename__ = "media"
    __table_args__ = (UniqueConstraint("role", "sha256", "mask", "matching"),)

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    role: Mapped[str] = mapped_column(String(16))
    #: how it is vectorised; the same bytes with other settings are another medium
    mask: Mapped[str] = mapped_column(String(16))
    matching: Mapped[str] = mapped_column(String(16))
    state: Mapped[str] = mapped_column(String(16))
    sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    content_type: Mapped[str] = mapped_column(String(64))
    filename: Mapped[str | None] = mapped_column(String(255))
    job_id: Mapped[str] = mapped_column(String(40))
    source_key: Mapped[str] = mapped_column(String(255))
    asset_key: Mapped[str | None] = mapped_column(String(255))
    asset_bytes: Mapped[int | None] = mapped_column(BigInteger)
    info: Mapped[dict[str, Any] | None]
    faces: Mapped[list[Any]] = mapped_column(default=list)
    warnings: Mapped[list[Any]] = mapped_column(default=list)
    error: Mapped[dict[str, Any] | None]
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class Job(Base):
    """One piece of work. `waiting` is true while a medium it needs is being vectorised; it then has no message."""

    __tablename__ = "jobs"
    __table_args__ = (Index(None, "state", "lease_expires_at"), Index(None, "queue", "state", "waiting"))

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    kind: Mapped[str] = mapped_column(String(16))
    queue: Mapped[str] = mapped_column(String(32))
    state: Mapped[str] = mapped_column(String(16))
    waiting: Mapped[bool]
    attempt: Mapped[int] = mapped_column(default=1)
    lease_token: Mapped[str | None] = mapped_column(String(40))
    lease_expires_at: Mapped[datetime | None]
    #: when the job was last queued: created, released from waiting, or queued for another attempt
    queued_at: Mapped[datetime]
    published_at: Mapped[datetime | None]
    media_id: Mapped[str | None] = mapped_column(String(40), index=True)
    request: Mapped[dict[str, Any]]
    stage: Mapped[str | None] = mapped_column(String(64))
    fraction: Mapped[float] = mapped_column(default=0.0)
    frames_done: Mapped[int] = mapped_column(default=0)
    frames_total: Mapped[int] = mapped_column(default=0)
    error: Mapped[dict[str, Any] | None]
    timings: Mapped[dict[str, Any] | None]
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]


class Look(Base):
    """One output of a job: the colours of a reference on a video."""

    __tablename__ = "looks"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    video_id: Mapped[str] = mapped_column(String(40), index=True)
    reference_id: Mapped[str] = mapped_column(String(40), index=True)
    params: Mapped[dict[str, Any]]
    #: what was found while it was drawn, see `service.catalog.results.Report`
    report: Mapped[dict[str, Any] | None]
    result_id: Mapped[str | None] = mapped_column(String(40))


class Result(Base):
    """A finished output. Its row appears with its job's end; `blob_key` goes away with the bytes."""

    __tablename__ = "results"

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    job_id: Mapped[str] = mapped_column(String(40), index=True)
    position: Mapped[int]
    video_id: Mapped[str] = mapped_column(String(40), index=True)
    reference_id: Mapped[str] = mapped_column(String(40), index=True)
    blob_key: Mapped[str | None] = mapped_column(String(255))
    sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    content_type: Mapped[str] = mapped_column(String(64))
    filename: Mapped[str] = mapped_column(String(255))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)
