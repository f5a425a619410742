"""by which vectorisation the parts of a job are drawn."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("parts", sa.Column("made_by", sa.JSON(), nullable=True))


def downgrade() -> None:
    op.drop_column("parts", "made_by")
