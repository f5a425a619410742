"""why the result of a look is no longer there."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("looks", sa.Column("result_gone", sa.String(length=16), nullable=True))
    looks = sa.table("looks", *(sa.column(name) for name in ("job_id", "position", "result_id", "result_gone")))
    jobs = sa.table("jobs", sa.column("id"), sa.column("state"))
    results = sa.table("results", *(sa.column(name) for name in ("job_id", "position", "part_of")))
    made = sa.exists().where(jobs.c.id == looks.c.job_id, jobs.c.state == "succeeded")
    # the row of a result outlives its bytes, not its media
    kept = sa.exists().where(
        results.c.job_id == looks.c.job_id, results.c.position == looks.c.position, results.c.part_of.is_(None)
    )
    why = sa.case((kept, "expired"), else_="deleted")
    op.execute(looks.update().where(looks.c.result_id.is_(None), made).values(result_gone=why))


def downgrade() -> None:
    with op.batch_alter_table("looks", schema=None) as batch_op:
        batch_op.drop_column("result_gone")
