"""Bring the database's tables to the version of this code."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import structlog
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect
from sqlalchemy.exc import DBAPIError

from service.catalog.database import make_engine
from service.outages import is_locked

log = structlog.get_logger(__name__)

#: seconds for which a change of tables that others use is tried again, and between two tries
_PATIENCE_S: Final = 300.0
_PAUSE_S: Final = 5.0


def _config(url: str) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent))
    config.attributes["url"] = url
    return config


class VersionError(Exception):
    """A version of the tables that this code does not know."""


def migrate(url: str) -> None:
    """Apply the migrations that are missing. Safe to run by several processes at once.

    Raises `VersionError`, and the database's error when others have used a table for all of five minutes.
    """
    config = _config(url)
    _here(url, _versions(config))
    _run(command.upgrade, config, "head")


def migrate_to(url: str, version: str) -> None:
    """Bring the tables to a version of this code's list, such as ``0011``, up or down.

    What an older version has no place for is lost. Raises `VersionError` for a version that is not in the list, and
    for tables that are of none of them; else as `migrate`.
    """
    config = _config(url)
    versions = _versions(config)
    if version not in versions:
        raise VersionError(f"there is no version {version}; they are {versions[0]} to {versions[-1]}")
    here = _here(url, versions)
    is_down = here is not None and versions.index(version) < versions.index(here)
    _run(command.downgrade if is_down else command.upgrade, config, version)


def _run(change: Callable[[Config, str], None], config: Config, version: str) -> None:
    """Change the tables, all or nothing, between what others do with them.

    Who reads a table for long, as a backup does, keeps it from being changed, and the change that waits would keep all
    others from it: it waits for a moment at a time.
    """
    until = time.monotonic() + _PATIENCE_S
    while True:
        try:
            change(config, version)
        except DBAPIError as error:
            if time.monotonic() > until or not (is_locked(error) or _is_deadlock(error)):
                raise
        else:
            return
        log.warning("others use the tables, as a backup does; changing them is tried again", seconds=_PAUSE_S)
        time.sleep(_PAUSE_S)


def _is_deadlock(error: DBAPIError) -> bool:
    return getattr(error.orig, "sqlstate", None) == "40P01"


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
