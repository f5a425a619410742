"""settings of media and reports of looks."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.add_column(sa.Column("mask", sa.String(length=16), nullable=True))
        batch_op.add_column(sa.Column("matching", sa.String(length=16), nullable=True))
    # there were no others
    op.execute("UPDATE media SET mask = 'landmarks', matching = 'table'")
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.alter_column("mask", existing_type=sa.String(length=16), nullable=False)
        batch_op.alter_column("matching", existing_type=sa.String(length=16), nullable=False)
        batch_op.drop_constraint(batch_op.f("uq_media_role_sha256"), type_="unique")
        batch_op.create_unique_constraint(
            batch_op.f("uq_media_role_sha256_mask_matching"), ["role", "sha256", "mask", "matching"]
        )
    with op.batch_alter_table("looks", schema=None) as batch_op:
        batch_op.add_column(sa.Column("report", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    with op.batch_alter_table("looks", schema=None) as batch_op:
        batch_op.drop_column("report")
    # the former version knows one medium for the same bytes, and only these settings
    op.execute("DELETE FROM media WHERE mask <> 'landmarks' OR matching <> 'table'")
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.drop_constraint(batch_op.f("uq_media_role_sha256_mask_matching"), type_="unique")
        batch_op.create_unique_constraint(batch_op.f("uq_media_role_sha256"), ["role", "sha256"])
        batch_op.drop_column("matching")
        batch_op.drop_column("mask")
