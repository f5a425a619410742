"""jobs that are done in parts, by several workers at once."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("parent_id", sa.String(length=40), nullable=True))
    op.create_index(op.f("ix_jobs_parent_id"), "jobs", ["parent_id"], unique=False)
    op.create_table(
        "parts",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("video_id", sa.String(length=40), nullable=False),
        sa.Column("start", sa.Integer(), nullable=False),
        sa.Column("stop", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["id"], ["jobs.id"], name=op.f("fk_parts_id_jobs"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_parts")),
    )
    op.create_table(
        "part_files",
        sa.Column("part_id", sa.String(length=40), nullable=False),
        sa.Column("position", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("blob_key", sa.String(length=255), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["part_id"], ["parts.id"], name=op.f("fk_part_files_part_id_parts"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("part_id", "position", name=op.f("pk_part_files")),
    )
    op.create_index(op.f("ix_part_files_blob_key"), "part_files", ["blob_key"], unique=False)


def downgrade() -> None:
    # the former version knows no parts: jobs that are being done in parts begin anew, those that are being canceled
    # are ended by its reaper, and files of parts, which no record names then, are removed
    op.drop_table("part_files")
    op.drop_table("parts")
    names = ("parent_id", "state", "lease_token", "lease_expires_at", "queued_at", "published_at", "updated_at")
    jobs = sa.table("jobs", *(sa.column(name) for name in names))
    op.execute(jobs.delete().where(jobs.c.parent_id.is_not(None)))
    free, changed_at = jobs.c.lease_token.is_(None), jobs.c.updated_at
    anew = {"state": "queued", "queued_at": changed_at, "published_at": None}
    op.execute(jobs.update().where(free, jobs.c.state == "running").values(anew))
    lapsed = {"lease_token": "", "lease_expires_at": changed_at}
    op.execute(jobs.update().where(free, jobs.c.state == "canceling").values(lapsed))
    op.drop_index(op.f("ix_jobs_parent_id"), table_name="jobs")
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.drop_column("parent_id")
