"""no statistics of what clients say: PostgreSQL keeps values of a column in them after their rows are deleted."""

from __future__ import annotations

from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None

#: by table, columns with their types, which stay as they are; in the order in which a request comes to the tables
_SAID = {
    "idempotent_requests": {"key": "VARCHAR(255)"},
    "resumable_uploads": {"filename": "VARCHAR(255)", "said": "TEXT", "webhook": "TEXT"},
    "media": {"filename": "VARCHAR(255)"},
    "results": {"filename": "VARCHAR(255)"},
    "deliveries": {"url": "VARCHAR(2048)", "origin": "VARCHAR(300)"},
    "webhook_secrets": {"secret": "VARCHAR(80)", "former": "VARCHAR(80)"},
}


def upgrade() -> None:
    _alter("ALTER COLUMN {column} SET STATISTICS 0, ALTER COLUMN {column} TYPE {type}")  # the latter drops those it has


def downgrade() -> None:
    _alter("ALTER COLUMN {column} SET STATISTICS -1")


def _alter(action: str) -> None:
    """Alter each of the columns where there are statistics; SQLite keeps none."""
    if op.get_bind().dialect.name != "postgresql":
        return
    for table, columns in _SAID.items():
        actions = (action.format(column=column, type=type_) for column, type_ in columns.items())
        op.execute(f"ALTER TABLE {table} {', '.join(actions)}")
