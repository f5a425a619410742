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
    Text,
    TypeDecorator,
    UniqueConstraint,
    text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column


class Role(StrEnum):
    """What a medium was uploaded for. A video may serve as a reference too; not the other way round."""

    VIDEO = "video"
    REFERENCE = "reference"


class MediaState(StrEnum):
    """Where a medium stands; `service.catalog.transitions` has the steps."""

    VECTORIZING = "vectorizing"  # -> ready, failed
    READY = "ready"  # -> vectorizing
    FAILED = "failed"  # -> vectorizing


class JobKind(StrEnum):
    """What a job does."""

    VECTORIZE = "vectorize"
    TRANSFER = "transfer"
    SWAP = "swap"


class PartKind(StrEnum):
    """What a row of `Job` does that is a share of another one, see `service.catalog.parts`. Clients never see these."""

    PART = "part"  # draws some frames
    JOIN = "join"  # makes the results of all parts


class JobState(StrEnum):
    """Where a job stands; `service.catalog.transitions` has the steps."""

    QUEUED = "queued"  # -> queued (its media are ready), running, failed, canceled, expired
    RUNNING = "running"  # -> queued (next attempt), canceling, succeeded, failed, canceled, expired
    CANCELING = "canceling"  # -> canceled
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELED = "canceled"
    EXPIRED = "expired"


class DeliveryState(StrEnum):
    """Where the delivery of a webhook stands."""

    WAITING = "waiting"  # for its job's end -> pending
    PENDING = "pending"  # -> delivered, failed, pending (the next attempt)
    DELIVERED = "delivered"  # -> pending (replayed)
    FAILED = "failed"  # -> pending (replayed)


class PreviewState(StrEnum):
    """Where a single picture stands; `service.catalog.previews` has the steps."""

    ASKED = "asked"  # -> taken
    TAKEN = "taken"  # -> done, failed
    DONE = "done"
    FAILED = "failed"


HELD: Final = (JobState.RUNNING, JobState.CANCELING)
ACTIVE: Final = (JobState.QUEUED, *HELD)
ENDED: Final = (JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELED, JobState.EXPIRED)


#: of an index of jobs: those that clients asked for and that have ended, and those that are shares of another
_OVER: Final = text("parent_id IS NULL AND finished_at IS NOT NULL")
_IS_PART: Final = text("parent_id IS NOT NULL")
#: of an index of results: those whose bytes are there
_KEPT: Final = text("blob_key IS NOT NULL")


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
    __table_args__ = (
        UniqueConstraint("owner", "role", "sha256", "mask", "matching", "input_color"),
        Index(None, "owner", "id"),
        Index(None, "owner", "role", "state", "id"),
        # what an owner's bytes are counted by, and when the first of them go
        Index(None, "owner", "expires_at", "size_bytes", "asset_bytes"),
    )

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    #: the key that uploaded it, see `service.catalog.keys`; the same bytes of two keys are two media
    owner: Mapped[str] = mapped_column(String(40), default="")
    role: Mapped[str] = mapped_column(String(16))
    #: how it is vectorised; the same bytes with other settings are another medium
    mask: Mapped[str] = mapped_column(String(16))
    matching: Mapped[str] = mapped_column(String(16))
    input_color: Mapped[str] = mapped_column(String(16))
    state: Mapped[str] = mapped_column(String(16))
    sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    content_type: Mapped[str] = mapped_column(String(64))
    filename: Mapped[str | None] = mapped_column(String(255))
    job_id: Mapped[str] = mapped_column(String(40), index=True)
    source_key: Mapped[str] = mapped_column(String(255), index=True)
    asset_key: Mapped[str | None] = mapped_column(String(255), index=True)
    #: of all that was made of it: asset and small pictures
    asset_bytes: Mapped[int | None] = mapped_column(BigInteger)
    #: a blob of JPEG pictures, one after the other, and where each is, see `service.catalog.media.Pictures`
    pictures_key: Mapped[str | None] = mapped_column(String(255), index=True)
    pictures: Mapped[list[Any] | None]
    info: Mapped[dict[str, Any] | None]
    faces: Mapped[list[Any]] = mapped_column(default=list)
    warnings: Mapped[list[Any]] = mapped_column(default=list)
    #: names and values that its owner gave it
    metadata_: Mapped[dict[str, Any]] = mapped_column("metadata", default=dict)
    error: Mapped[dict[str, Any] | None]
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class Job(Base):
    """One piece of work. `waiting` is true while a medium it needs is being vectorised; it then has no message.

    A row with a ``parent_id`` is a share of another job's work, see `service.catalog.parts`: workers do it as any other
    job, and clients do not see it. A job that is being done in parts is running, and has no lease.
    """

    __tablename__ = "jobs"
    __table_args__ = (
        Index(None, "state", "lease_expires_at"),
        Index(None, "queue", "state", "waiting", "owner"),
        Index(None, "queue", "owner", "started_at"),
        Index(None, "owner", "id"),
        Index(None, "owner", "state", "id"),
        Index(None, "owner", "fingerprint", "id"),
        Index(None, "kind", "state", "finished_at", "owner", "id", sqlite_where=_OVER, postgresql_where=_OVER),
        # most have none, and an engine without statistics takes an index of all for a way to those
        Index(None, "parent_id", sqlite_where=_IS_PART, postgresql_where=_IS_PART),
    )

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    #: the key that asked for it, see `service.catalog.keys`
    owner: Mapped[str] = mapped_column(String(40), default="")
    #: the job that this is a share of; None of those that clients ask for
    parent_id: Mapped[str | None] = mapped_column(String(40))
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
    #: of what it makes: two requests for the same have the same
    fingerprint: Mapped[str | None] = mapped_column(String(64))
    metadata_: Mapped[dict[str, Any]] = mapped_column("metadata", default=dict)
    stage: Mapped[str | None] = mapped_column(String(64))
    fraction: Mapped[float] = mapped_column(default=0.0)
    frames_done: Mapped[int] = mapped_column(default=0)
    frames_total: Mapped[int] = mapped_column(default=0)
    #: of the request that made it, see `service.tracing`
    traceparent: Mapped[str | None] = mapped_column(String(55))
    error: Mapped[dict[str, Any] | None]
    timings: Mapped[dict[str, Any] | None]
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]


class Part(Base):
    """Frames [start, stop) of a video that a job changes: all of its looks on that video, as files of their own.

    What it has in common with a job, its lease and its attempts among it, is in the row of `Job` with the same id.
    """

    __tablename__ = "parts"

    id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    #: of all parts of the job, from 0: by video, then by time
    number: Mapped[int]
    video_id: Mapped[str] = mapped_column(String(40))
    start: Mapped[int]
    stop: Mapped[int]
    #: what vectorised each medium of the job as it was cut: jobs by ids of media; None if an older version cut it
    made_by: Mapped[dict[str, Any] | None]


class PartFile(Base):
    """What a part has drawn of one look. It goes when the job ends."""

    __tablename__ = "part_files"

    part_id: Mapped[str] = mapped_column(ForeignKey("parts.id", ondelete="CASCADE"), primary_key=True)
    #: of the look among those of the job
    position: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    blob_key: Mapped[str] = mapped_column(String(255), index=True)
    size_bytes: Mapped[int] = mapped_column(BigInteger)


class RemovedJobs(Base):
    """How many jobs have ended whose records are removed, so that counts of ended jobs never fall."""

    __tablename__ = "removed_jobs"

    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    state: Mapped[str] = mapped_column(String(16), primary_key=True)
    count: Mapped[int] = mapped_column(BigInteger)


class MonthlyUsage(Base):
    """What an owner has had done in a month, see `service.catalog.ledger`; it outlives the records of all that."""

    __tablename__ = "monthly_usage"

    #: no reference to a key: one would be locked with it
    owner: Mapped[str] = mapped_column(String(40), primary_key=True)
    #: of UTC, such as "2026-11"
    month: Mapped[str] = mapped_column(String(7), primary_key=True)
    #: jobs that ended, by state
    succeeded: Mapped[int] = mapped_column(BigInteger, default=0)
    failed: Mapped[int] = mapped_column(BigInteger, default=0)
    canceled: Mapped[int] = mapped_column(BigInteger, default=0)
    expired: Mapped[int] = mapped_column(BigInteger, default=0)
    #: of jobs that succeeded, and what the videos of these looks have of frames and of time
    looks: Mapped[int] = mapped_column(BigInteger, default=0)
    frames: Mapped[int] = mapped_column(BigInteger, default=0)
    milliseconds: Mapped[int] = mapped_column(BigInteger, default=0)
    #: files that became media
    uploads: Mapped[int] = mapped_column(BigInteger, default=0)
    upload_bytes: Mapped[int] = mapped_column(BigInteger, default=0)


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
    result_id: Mapped[str | None] = mapped_column(String(40), index=True)
    #: why it has a result no longer: it has `expired`, or was `deleted` with one of its media
    result_gone: Mapped[str | None] = mapped_column(String(16))


class Result(Base):
    """A finished output, or a part of one. Its row appears with its job's end; `blob_key` goes away with the bytes.

    A part lives and ends as its result does: it has the same job, media and retention.
    """

    __tablename__ = "results"
    __table_args__ = (Index(None, "owner", "expires_at", "size_bytes", sqlite_where=_KEPT, postgresql_where=_KEPT),)

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    owner: Mapped[str] = mapped_column(String(40), default="", index=True)
    job_id: Mapped[str] = mapped_column(String(40), index=True)
    position: Mapped[int]
    video_id: Mapped[str] = mapped_column(String(40), index=True)
    reference_id: Mapped[str] = mapped_column(String(40), index=True)
    blob_key: Mapped[str | None] = mapped_column(String(255), index=True)
    sha256: Mapped[str] = mapped_column(String(64))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    content_type: Mapped[str] = mapped_column(String(64))
    filename: Mapped[str] = mapped_column(String(255))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)
    #: of a part: the result it belongs to, what it is, see `service.catalog.results.PartName`, and whose, from 1
    part_of: Mapped[str | None] = mapped_column(String(40), index=True)
    part: Mapped[str | None] = mapped_column(String(16))
    person: Mapped[int | None]


class Preview(Base):
    """A single picture that is asked for, for some seconds; see `service.catalog.previews`."""

    __tablename__ = "previews"
    __table_args__ = (Index(None, "owner", "fingerprint"),)

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    owner: Mapped[str] = mapped_column(String(40), default="")
    #: the medium that is drawn, and the reference whose look it is given
    media_id: Mapped[str] = mapped_column(String(40), index=True)
    reference_id: Mapped[str | None] = mapped_column(String(40), index=True)
    #: of what is asked for and what it depends on
    fingerprint: Mapped[str] = mapped_column(String(64))
    state: Mapped[str] = mapped_column(String(16))
    request: Mapped[dict[str, Any]]
    blob_key: Mapped[str | None] = mapped_column(String(255))
    size_bytes: Mapped[int | None] = mapped_column(BigInteger)
    frame: Mapped[int | None]
    error: Mapped[dict[str, Any] | None]
    created_at: Mapped[datetime] = mapped_column(index=True)


class Worker(Base):
    """A process that does work and is alive, see `service.catalog.workers`."""

    __tablename__ = "workers"

    id: Mapped[str] = mapped_column(String(80), primary_key=True)
    started_at: Mapped[datetime]
    seen_at: Mapped[datetime]
    #: what it does, see `service.catalog.workers.Kind`
    kind: Mapped[str] = mapped_column(String(16), default="jobs")
    #: what keeps it from doing jobs; None when nothing does
    lacks: Mapped[str | None] = mapped_column(String(80))


class Tombstone(Base):
    """A blob that no record names: it is to be deleted, or is being written and not recorded yet.

    It stays until every byte of the blob is gone. One that is being written is deleted when it is not recorded in time,
    or when nobody holds the lease it is written under any more.
    """

    __tablename__ = "tombstones"

    blob_key: Mapped[str] = mapped_column(String(255), primary_key=True)
    #: deletions that have failed
    attempts: Mapped[int] = mapped_column(default=0)
    created_at: Mapped[datetime]
    #: when it is deleted, or tried again
    due_at: Mapped[datetime] = mapped_column(index=True)
    #: of the job whose worker writes it
    lease_token: Mapped[str | None] = mapped_column(String(40))


class Collection(Base):
    """What is known of searches for files without a record, in one row; see `service.catalog.collecting`."""

    __tablename__ = "collections"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    #: of this database; its store carries it too
    database_id: Mapped[str] = mapped_column(String(32))
    #: searches that found the store to be this database's
    number: Mapped[int] = mapped_column(BigInteger)
    #: when the last one began
    began_at: Mapped[datetime | None]
    #: why nothing is removed
    halted: Mapped[str | None] = mapped_column(String(32))


class Key(Base):
    """Who may use the service. Kept for ever: a revoked one still keeps the service closed to those without."""

    __tablename__ = "keys"
    __table_args__ = (UniqueConstraint("name"),)

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    name: Mapped[str] = mapped_column(String(100))
    secret_sha256: Mapped[str] = mapped_column(String(64))
    #: the secret before it, which is good until then as well
    former_sha256: Mapped[str | None] = mapped_column(String(64))
    former_until: Mapped[datetime | None]
    requests_per_minute: Mapped[int]
    active_jobs: Mapped[int]
    stored_bytes: Mapped[int] = mapped_column(BigInteger)
    #: the last window in which requests were counted, and how many of them are handed out to processes
    window_number: Mapped[int] = mapped_column(BigInteger)
    window_requests: Mapped[int]
    created_at: Mapped[datetime]
    revoked_at: Mapped[datetime | None]


_WAITING: Final = text("state = 'waiting'")


class Delivery(Base):
    """One event of one job for one receiver: that the job has ended. Recorded with the job, due when it ends."""

    __tablename__ = "deliveries"
    __table_args__ = (
        Index(None, "job_id"),
        # two requests at once that name one receiver
        Index(None, "job_id", "url", unique=True, sqlite_where=_WAITING, postgresql_where=_WAITING),
        Index(None, "state", "next_at"),
        Index(None, "owner", "id"),
    )

    #: the `webhook-id`, the same in every attempt
    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    owner: Mapped[str] = mapped_column(String(40), default="")
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"))
    url: Mapped[str] = mapped_column(String(2048))
    #: scheme, host and port of the URL: receivers are told apart by it
    origin: Mapped[str] = mapped_column(String(300))
    state: Mapped[str] = mapped_column(String(16))
    #: since it was pending first, or was asked for again
    attempts: Mapped[int] = mapped_column(default=0)
    #: of a pending one: when it is attempted, or, while it is, when the one who does counts as lost
    next_at: Mapped[datetime | None]
    lease_token: Mapped[str | None] = mapped_column(String(40))
    last_status: Mapped[int | None]
    last_error: Mapped[str | None] = mapped_column(String(80))
    created_at: Mapped[datetime]
    last_attempt_at: Mapped[datetime | None]
    delivered_at: Mapped[datetime | None]


class WebhookSecret(Base):
    """What an owner's webhooks are signed with. Readable, as a signature needs it."""

    __tablename__ = "webhook_secrets"

    owner: Mapped[str] = mapped_column(String(40), primary_key=True)
    secret: Mapped[str] = mapped_column(String(80))
    created_at: Mapped[datetime]
    #: the one before, signed with as well until then
    former: Mapped[str | None] = mapped_column(String(80))
    former_until: Mapped[datetime | None]
    #: those before it, the newest first: [secret, until when (ISO 8601)]
    older: Mapped[list[Any] | None]


class IdempotentRequest(Base):
    """A request that named an Idempotency-Key, and its answer once there is one."""

    __tablename__ = "idempotent_requests"

    owner: Mapped[str] = mapped_column(String(40), primary_key=True)
    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    token: Mapped[str] = mapped_column(String(32))
    locked_until: Mapped[datetime]
    digest: Mapped[str | None] = mapped_column(String(64))
    status: Mapped[int | None]
    location: Mapped[str | None] = mapped_column(String(255))
    body: Mapped[dict[str, Any] | None]
    resource_id: Mapped[str | None] = mapped_column(String(40), index=True)
    expires_at: Mapped[datetime] = mapped_column(index=True)


class ResumableUpload(Base):
    """A file that arrives in pieces. It is open until its medium is recorded: then it only tells which one that is."""

    __tablename__ = "resumable_uploads"

    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    owner: Mapped[str] = mapped_column(String(40), index=True)
    role: Mapped[str] = mapped_column(String(16))
    mask: Mapped[str] = mapped_column(String(16))
    matching: Mapped[str] = mapped_column(String(16))
    input_color: Mapped[str] = mapped_column(String(16))
    metadata_: Mapped[dict[str, Any]] = mapped_column("metadata", default=dict)
    #: the receiver that is told when its medium is vectorised
    webhook: Mapped[str | None] = mapped_column(Text)
    filename: Mapped[str | None] = mapped_column(String(255))
    #: what its sender said of it, as it was said
    said: Mapped[str | None] = mapped_column(Text)
    #: what it may have at most; its size, once that is known; how many of its bytes are there
    limit_bytes: Mapped[int] = mapped_column(BigInteger)
    size_bytes: Mapped[int | None] = mapped_column(BigInteger)
    offset_bytes: Mapped[int] = mapped_column(BigInteger, default=0)
    media_id: Mapped[str | None] = mapped_column(String(40), index=True)
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime] = mapped_column(index=True)


class UploadPart(Base):
    """Bytes of a file that arrives in pieces, in the storage until the medium is recorded."""

    __tablename__ = "upload_parts"

    upload_id: Mapped[str] = mapped_column(ForeignKey("resumable_uploads.id"), primary_key=True)
    #: where in the file they stand
    start_bytes: Mapped[int] = mapped_column(BigInteger, primary_key=True)
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    blob_key: Mapped[str] = mapped_column(String(255), index=True)
