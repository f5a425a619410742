"""several former secrets of webhooks, each until its own time."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("webhook_secrets", sa.Column("older", sa.JSON(), nullable=True))


def downgrade() -> None:
    op.drop_column("webhook_secrets", "older")
