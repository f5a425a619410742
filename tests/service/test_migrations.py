from __future__ import annotations

import subprocess
import sys

from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import inspect

from service.catalog.database import Database, make_engine
from service.catalog.migrate import _config, is_current, migrate
from service.catalog.models import Base


def test_the_migrations_make_the_tables_of_the_models(database: Database) -> None:
    engine = make_engine(database.url)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    engine.dispose()
    assert is_current(database.url)


def test_migrating_again_changes_nothing_and_down_removes_everything(database: Database) -> None:
    migrate(database.url)
    assert is_current(database.url)
    command.downgrade(_config(database.url), "base")
    engine = make_engine(database.url)
    assert inspect(engine).get_table_names() == ["alembic_version"]
    engine.dispose()


def test_several_processes_may_migrate_at_once(database: Database) -> None:
    command.downgrade(_config(database.url), "base")
    code = "import sys; from service.catalog.migrate import migrate; migrate(sys.argv[1])"
    started = [subprocess.Popen([sys.executable, "-c", code, database.url]) for _ in range(3)]
    assert [process.wait(60) for process in started] == [0, 0, 0]
    assert is_current(database.url)
