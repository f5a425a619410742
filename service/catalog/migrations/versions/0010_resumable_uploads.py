"""uploads that arrive in pieces."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "resumable_uploads",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("owner", sa.String(length=40), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("mask", sa.String(length=16), nullable=False),
        sa.Column("matching", sa.String(length=16), nullable=False),
        sa.Column("input_color", sa.String(length=16), nullable=False),
        sa.Column("metadata", sa.JSON(none_as_null=True), nullable=False),
        sa.Column("filename", sa.String(length=255), nullable=True),
        sa.Column("said", sa.Text(), nullable=True),
        sa.Column("limit_bytes", sa.BigInteger(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=True),
        sa.Column("offset_bytes", sa.BigInteger(), nullable=False),
        sa.Column("media_id", sa.String(length=40), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_resumable_uploads")),
    )
    for column in ("owner", "media_id", "expires_at"):
        op.create_index(op.f(f"ix_resumable_uploads_{column}"), "resumable_uploads", [column], unique=False)
    op.create_table(
        "upload_parts",
        sa.Column("upload_id", sa.String(length=40), nullable=False),
        sa.Column("start_bytes", sa.BigInteger(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("blob_key", sa.String(length=255), nullable=False),
        sa.ForeignKeyConstraint(
            ["upload_id"], ["resumable_uploads.id"], name=op.f("fk_upload_parts_upload_id_resumable_uploads")
        ),
        sa.PrimaryKeyConstraint("upload_id", "start_bytes", name=op.f("pk_upload_parts")),
    )
    op.create_index(op.f("ix_upload_parts_blob_key"), "upload_parts", ["blob_key"], unique=False)


def downgrade() -> None:
    # the former version knows no blobs of parts, and removes them as files without a record
    op.drop_table("upload_parts")
    op.drop_table("resumable_uploads")
