"""a receiver that is told of a job's end again, by a delivery of its own."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

_FORMER = "uq_deliveries_job_id_url"
_INDEX = "ix_deliveries_job_id"
_ONCE = "ix_deliveries_job_id_url"
_WAITING = sa.text("state = 'waiting'")


def upgrade() -> None:
    with op.batch_alter_table("deliveries", schema=None) as batch_op:
        batch_op.drop_constraint(batch_op.f(_FORMER), type_="unique")
        batch_op.create_index(batch_op.f(_INDEX), ["job_id"], unique=False)
        batch_op.create_index(
            batch_op.f(_ONCE), ["job_id", "url"], unique=True, sqlite_where=_WAITING, postgresql_where=_WAITING
        )


def downgrade() -> None:
    # the former version knows one for each
    op.execute("DELETE FROM deliveries WHERE id NOT IN (SELECT min(id) FROM deliveries GROUP BY job_id, url)")
    with op.batch_alter_table("deliveries", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f(_ONCE))
        batch_op.drop_index(batch_op.f(_INDEX))
        batch_op.create_unique_constraint(batch_op.f(_FORMER), ["job_id", "url"])
