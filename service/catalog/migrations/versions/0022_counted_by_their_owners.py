"""indexes by which bytes and jobs of an owner are counted, and jobs that have ended found, without reading them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

_INDEXES = (
    ("jobs", ["owner", "state", "id"], None),
    ("jobs", ["owner", "fingerprint", "id"], None),
    ("jobs", ["kind", "state", "finished_at", "owner", "id"], "parent_id IS NULL AND finished_at IS NOT NULL"),
    ("media", ["owner", "role", "state", "id"], None),
    ("media", ["owner", "expires_at", "size_bytes", "asset_bytes"], None),
    ("results", ["owner", "expires_at", "size_bytes"], "blob_key IS NOT NULL"),
)
#: one of more columns stands for it: the newest of the same is found, not looked for among all of an owner
_FINGERPRINT = "ix_jobs_owner_fingerprint"
_PARENT = "ix_jobs_parent_id"


def upgrade() -> None:
    for table, columns, where in _INDEXES:
        name = op.f(f"ix_{table}_{'_'.join(columns)}")
        condition = None if where is None else sa.text(where)
        op.create_index(name, table, columns, postgresql_where=condition, sqlite_where=condition)
    op.drop_index(op.f(_FINGERPRINT), table_name="jobs")
    # most jobs have no parent: an index of those that have one is small, and is not taken for a way to the others
    op.drop_index(op.f(_PARENT), table_name="jobs")
    parts = sa.text("parent_id IS NOT NULL")
    op.create_index(op.f(_PARENT), "jobs", ["parent_id"], postgresql_where=parts, sqlite_where=parts)


def downgrade() -> None:
    op.drop_index(op.f(_PARENT), table_name="jobs")
    op.create_index(op.f(_PARENT), "jobs", ["parent_id"])
    op.create_index(op.f(_FINGERPRINT), "jobs", ["owner", "fingerprint"])
    for table, columns, _ in _INDEXES:
        op.drop_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table_name=table)
