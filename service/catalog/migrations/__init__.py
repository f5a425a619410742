"""Bring the database's tables to the version of this code."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from service.catalog.database import make_engine


def _config(url: str) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent))
    config.attributes["url"] = url
    return config


def migrate(url: str) -> None:
    """Apply the migrations that are missing. Safe to run by several processes at once."""
    command.upgrade(_config(url), "head")


def is_current(url: str) -> bool:
    """True when the database is at the version of this code."""
    engine = make_engine(url)
    try:
        with engine.connect() as connection:
            here = MigrationContext.configure(connection).get_current_revision()
    finally:
        engine.dispose()
    return here == ScriptDirectory.from_config(_config(url)).get_current_head()
