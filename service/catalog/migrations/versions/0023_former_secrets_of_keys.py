"""secrets that keys had before, and until when each is good."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("keys", sa.Column("former_sha256", sa.String(64), nullable=True))
    op.add_column("keys", sa.Column("former_until", sa.DateTime(timezone=True), nullable=True))


def downgrade() -> None:
    op.drop_column("keys", "former_until")
    op.drop_column("keys", "former_sha256")
