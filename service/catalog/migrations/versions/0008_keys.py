"""keys, what belongs to whom, and requests that are made once."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

_UNIQUE = ["role", "sha256", "mask", "matching", "input_color"]


def upgrade() -> None:
    op.create_table(
        "keys",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("secret_sha256", sa.String(length=64), nullable=False),
        sa.Column("requests_per_minute", sa.Integer(), nullable=False),
        sa.Column("active_jobs", sa.Integer(), nullable=False),
        sa.Column("stored_bytes", sa.BigInteger(), nullable=False),
        sa.Column("window_number", sa.BigInteger(), nullable=False),
        sa.Column("window_requests", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_keys")),
        sa.UniqueConstraint("name", name=op.f("uq_keys_name")),
    )
    op.create_table(
        "idempotent_requests",
        sa.Column("owner", sa.String(length=40), nullable=False),
        sa.Column("key", sa.String(length=255), nullable=False),
        sa.Column("token", sa.String(length=32), nullable=False),
        sa.Column("locked_until", sa.DateTime(timezone=True), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=True),
        sa.Column("status", sa.Integer(), nullable=True),
        sa.Column("location", sa.String(length=255), nullable=True),
        sa.Column("body", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("resource_id", sa.String(length=40), nullable=True),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("owner", "key", name=op.f("pk_idempotent_requests")),
    )
    for column in ("expires_at", "resource_id"):
        op.create_index(op.f(f"ix_idempotent_requests_{column}"), "idempotent_requests", [column], unique=False)
    # what there is belongs to nobody: `pvg-service keys assign` gives it to a key
    owner, metadata = sa.String(length=40), sa.JSON(none_as_null=True)
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.add_column(sa.Column("owner", owner, nullable=False, server_default=""))
        batch_op.add_column(sa.Column("metadata", metadata, nullable=False, server_default="{}"))
        batch_op.drop_constraint(batch_op.f(f"uq_media_{'_'.join(_UNIQUE)}"), type_="unique")
        batch_op.create_unique_constraint(batch_op.f(f"uq_media_owner_{'_'.join(_UNIQUE)}"), ["owner", *_UNIQUE])
        batch_op.create_index(batch_op.f("ix_media_owner_id"), ["owner", "id"], unique=False)
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.add_column(sa.Column("owner", owner, nullable=False, server_default=""))
        batch_op.add_column(sa.Column("metadata", metadata, nullable=False, server_default="{}"))
        batch_op.add_column(sa.Column("fingerprint", sa.String(length=64), nullable=True))
        batch_op.drop_index(batch_op.f("ix_jobs_queue_state_waiting"))
        for columns in _INDEXES:
            batch_op.create_index(batch_op.f(f"ix_jobs_{'_'.join(columns)}"), columns, unique=False)
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.add_column(sa.Column("owner", owner, nullable=False, server_default=""))
        batch_op.create_index(batch_op.f("ix_results_owner"), ["owner"], unique=False)
    for table, filled in (("media", ("owner", "metadata")), ("jobs", ("owner", "metadata")), ("results", ("owner",))):
        with op.batch_alter_table(table, schema=None) as batch_op:
            for column in filled:
                kind = owner if column == "owner" else metadata
                batch_op.alter_column(column, existing_type=kind, existing_nullable=False, server_default=None)


_INDEXES = (
    ["queue", "state", "waiting", "owner"],
    ["queue", "owner", "started_at"],
    ["owner", "id"],
    ["owner", "fingerprint"],
)


def downgrade() -> None:
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_results_owner"))
        batch_op.drop_column("owner")
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        for columns in _INDEXES:
            batch_op.drop_index(batch_op.f(f"ix_jobs_{'_'.join(columns)}"))
        batch_op.create_index(batch_op.f("ix_jobs_queue_state_waiting"), ["queue", "state", "waiting"], unique=False)
        batch_op.drop_column("fingerprint")
        batch_op.drop_column("metadata")
        batch_op.drop_column("owner")
    # the former version knows one medium for the same bytes and settings: the oldest stays
    same = " AND ".join(f"other.{column} = media.{column}" for column in _UNIQUE)
    op.execute(f"DELETE FROM media WHERE EXISTS (SELECT 1 FROM media AS other WHERE {same} AND other.id < media.id)")  # noqa: S608
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_media_owner_id"))
        batch_op.drop_constraint(batch_op.f(f"uq_media_owner_{'_'.join(_UNIQUE)}"), type_="unique")
        batch_op.create_unique_constraint(batch_op.f(f"uq_media_{'_'.join(_UNIQUE)}"), _UNIQUE)
        batch_op.drop_column("metadata")
        batch_op.drop_column("owner")
    op.drop_table("idempotent_requests")
    op.drop_table("keys")
