"""indexes by which looks are found by their results, media by their jobs and records by their files."""

from __future__ import annotations

from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None

_INDEXES = (
    ("looks", "result_id"),
    ("media", "job_id"),
    ("media", "source_key"),
    ("media", "asset_key"),
    ("media", "pictures_key"),
    ("results", "blob_key"),
)


def upgrade() -> None:
    for table, column in _INDEXES:
        op.create_index(op.f(f"ix_{table}_{column}"), table, [column])


def downgrade() -> None:
    for table, column in _INDEXES:
        op.drop_index(op.f(f"ix_{table}_{column}"), table_name=table)
