"""single pictures that are asked for, small pictures of media, and workers of two kinds."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "previews",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("owner", sa.String(length=40), nullable=False),
        sa.Column("media_id", sa.String(length=40), nullable=False),
        sa.Column("reference_id", sa.String(length=40), nullable=True),
        sa.Column("fingerprint", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("request", sa.JSON(none_as_null=True), nullable=False),
        sa.Column("blob_key", sa.String(length=255), nullable=True),
        sa.Column("size_bytes", sa.BigInteger(), nullable=True),
        sa.Column("frame", sa.Integer(), nullable=True),
        sa.Column("error", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_previews")),
    )
    for name, columns in _INDEXES.items():
        op.create_index(op.f(f"ix_previews_{name}"), "previews", columns, unique=False)
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.add_column(sa.Column("pictures_key", sa.String(length=255), nullable=True))
        batch_op.add_column(sa.Column("pictures", sa.JSON(none_as_null=True), nullable=True))
    with op.batch_alter_table("workers", schema=None) as batch_op:
        batch_op.add_column(sa.Column("kind", sa.String(length=16), nullable=False, server_default="jobs"))
    with op.batch_alter_table("workers", schema=None) as batch_op:
        kind = sa.String(length=16)
        batch_op.alter_column("kind", existing_type=kind, existing_nullable=False, server_default=None)


_INDEXES = {
    "owner_fingerprint": ["owner", "fingerprint"],
    "media_id": ["media_id"],
    "reference_id": ["reference_id"],
    "created_at": ["created_at"],
}


def downgrade() -> None:
    with op.batch_alter_table("workers", schema=None) as batch_op:
        batch_op.drop_column("kind")
    # the former version finds the small pictures as files without a record
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.drop_column("pictures")
        batch_op.drop_column("pictures_key")
    op.drop_table("previews")
