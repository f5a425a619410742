"""input color of media."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

_FORMER = "uq_media_role_sha256_mask_matching"
_SAME = ["role", "sha256", "mask", "matching", "input_color"]


def upgrade() -> None:
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.add_column(sa.Column("input_color", sa.String(length=16), nullable=True))
    # there was no other
    op.execute("UPDATE media SET input_color = 'auto'")
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.alter_column("input_color", existing_type=sa.String(length=16), nullable=False)
        batch_op.drop_constraint(batch_op.f(_FORMER), type_="unique")
        batch_op.create_unique_constraint(batch_op.f(f"{_FORMER}_input_color"), _SAME)


def downgrade() -> None:
    # the former version knows no other
    op.execute("DELETE FROM media WHERE input_color <> 'auto'")
    with op.batch_alter_table("media", schema=None) as batch_op:
        batch_op.drop_constraint(batch_op.f(f"{_FORMER}_input_color"), type_="unique")
        batch_op.create_unique_constraint(batch_op.f(_FORMER), _SAME[:-1])
        batch_op.drop_column("input_color")
