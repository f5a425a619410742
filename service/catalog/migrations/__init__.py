"""Bring the database's tables to the version of this code."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect

from service.catalog.database import make_engine


def _config(url: str) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent))
    config.attributes["url"] = url
    return config


class VersionError(Exception):
    """A version of the tables that this code does not know."""


def migrate(url: str) -> None:
    """Apply the migrations that are missing. Safe to run by several processes at once. Raises `VersionError`."""
    config = _config(url)
    _here(url, _versions(config))
    command.upgrade(config, "head")


def migrate_to(url: str, version: str) -> None:
    """Bring the tables to a version of this code's list, such as ``0011``, up or down.

    What an older version has no place for is lost. Raises `VersionError` for a version that is not in the list, and
    for tables that are of none of them.
    """
    config = _config(url)
    versions = _versions(config)
    if version not in versions:
        raise VersionError(f"there is no version {version}; they are {versions[0]} to {versions[-1]}")
    here = _here(url, versions)
    is_down = here is not None and versions.index(version) < versions.index(here)
    (command.downgrade if is_down else command.upgrade)(config, version)


def _versions(config: Config) -> list[str]:
    """All of this code, the oldest first."""
    return [script.revision for script in ScriptDirectory.from_config(config).walk_revisions()][::-1]


def _here(url: str, versions: list[str]) -> str | None:
    """The version of the tables; None without any. Raises `VersionError`."""
    here = _version(url)
    if here is not None and here not in versions:
        raise VersionError(f"the database's tables are of version {here}, which this code does not know")
    return here


def _version(url: str) -> str | None:
    engine = make_engine(url)
    try:
        with engine.connect() as connection:
            return MigrationContext.configure(connection).get_current_revision()
    finally:
        engine.dispose()


def is_current(url: str) -> bool:
    """True when the database is at the version of this code."""
    return _version(url) == ScriptDirectory.from_config(_config(url)).get_current_head()


def has_table(url: str, name: str) -> bool:
    """True when the database has a table of this name, whatever its version."""
    engine = make_engine(url)
    try:
        return inspect(engine).has_table(name)
    finally:
        engine.dispose()
