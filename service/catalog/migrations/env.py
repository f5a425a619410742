"""Alembic's entry point; run by `service.catalog.migrations`."""

from __future__ import annotations

from alembic import context
from sqlalchemy import event, text
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.pool import ConnectionPoolEntry

from service.catalog.database import make_engine
from service.catalog.models import Base

# any constant: it only has to differ from other users of the same database
LOCK = 7_301_984
#: milliseconds to wait for those who use a table. Whoever wants it later waits behind the one who wants to change it
TABLE_WAIT_MS = 2000


def _leave_rows_alone(connection: DBAPIConnection, _: ConnectionPoolEntry) -> None:
    """SQLite changes a table by making a new one and dropping the old, which would delete what refers to its rows."""
    cursor = connection.cursor()
    cursor.execute("PRAGMA foreign_keys=OFF")
    cursor.close()


def run() -> None:
    engine = make_engine(context.config.attributes["url"])
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _leave_rows_alone)
    writer = engine.execution_options(pvg_writes=True)
    try:
        with writer.begin() as connection:
            # several API processes may start at once; SQLite's write lock is taken by BEGIN IMMEDIATE
            if connection.dialect.name == "postgresql":
                # one that is at it takes as long as its tables are large
                connection.execute(text("SET LOCAL lock_timeout = 0"))
                connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": LOCK})
                connection.execute(text(f"SET LOCAL lock_timeout = {TABLE_WAIT_MS:d}"))
            context.configure(
                connection=connection, target_metadata=Base.metadata, render_as_batch=True, compare_type=True
            )
            with context.begin_transaction():
                context.run_migrations()
    finally:
        engine.dispose()


run()
