"""What commands of `pvg-service` begin and end with: settings, the records, and a refusal in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NoReturn, TypeVar

import typer
from pydantic import ValidationError
from sqlalchemy.orm import Session

from service.catalog import Database
from service.catalog.migrations import is_current
from service.errors import message_of
from service.queue import make_folders
from service.settings import Settings

CANNOT_START: Final = 1
BAD_ARGUMENTS: Final = 2

Answer = TypeVar("Answer")


def refuse(message: str, code: int = BAD_ARGUMENTS) -> NoReturn:
    """End the command with this reason."""
    typer.echo(f"pvg-service: {message.splitlines()[0]}", err=True)
    sys.exit(code)


def read_settings(**overrides: object) -> Settings:
    """The settings, with what the command was given instead; a wrong one ends the command."""
    given = {name: value for name, value in overrides.items() if value is not None}
    try:
        settings = Settings.model_validate(Settings().model_dump() | given) if given else Settings()
    except ValidationError as error:
        first = error.errors()[0]
        where = "_".join(str(part) for part in first["loc"]).upper()
        message = message_of(first)
        refuse(f"setting PVG_{where}: {message}" if where else message)
    return settings


def current_settings() -> Settings:
    """The settings, where the database is of this version; any other ends the command."""
    settings = read_settings()
    make_folders(settings)
    if not is_current(settings.database):
        refuse("the database is not of this version; run `pvg-service migrate` first")
    return settings


@contextmanager
def open_records(settings: Settings) -> Iterator[Database]:
    """The records, for the time of the block."""
    database = Database(settings.database)
    try:
        yield database
    finally:
        database.close()


def with_records(settings: Settings, work: Callable[[Session], Answer], *, write: bool = True) -> Answer:
    """What a step with the records gives, in one transaction."""
    with open_records(settings) as database, database.write() if write else database.read() as session:
        return work(session)
