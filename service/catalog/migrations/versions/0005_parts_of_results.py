"""parts of results."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.add_column(sa.Column("part_of", sa.String(length=40), nullable=True))
        batch_op.add_column(sa.Column("part", sa.String(length=16), nullable=True))
        batch_op.add_column(sa.Column("person", sa.Integer(), nullable=True))
        batch_op.create_index(batch_op.f("ix_results_part_of"), ["part_of"], unique=False)


def downgrade() -> None:
    # the former version would take them for results of their own; their bytes go as files without a record
    op.execute("DELETE FROM results WHERE part_of IS NOT NULL")
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_results_part_of"))
        batch_op.drop_column("person")
        batch_op.drop_column("part")
        batch_op.drop_column("part_of")
