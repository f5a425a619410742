"""`pvg-service`: serve, worker, migrate, gc."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import Annotated, NoReturn

import typer
import uvicorn
from obstore.exceptions import BaseError
from pydantic import ValidationError
from sqlalchemy.exc import ArgumentError, DBAPIError

from service.api import create_app, make_services
from service.catalog.migrations import is_current
from service.catalog.migrations import migrate as migrate_database
from service.errors import message_of
from service.logs import configure
from service.processes import WorkerProcess, worker_command, worker_environment
from service.queue import make_folders
from service.settings import Settings

cli = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="The face colour transfer service.",
)

CANNOT_START = 1
BAD_ARGUMENTS = 2
#: seconds that requests in flight get when the service stops
DRAIN_S = 20


def main() -> None:
    """Entry point of the `pvg-service` command: a reason not to start is one line, not a traceback."""
    try:
        cli()
    except OSError as error:
        where = f": {error.filename}" if error.filename is not None else ""
        _refuse(f"{error.strerror or error}{where}", CANNOT_START)
    except ArgumentError as error:
        _refuse(f"setting PVG_DATABASE_URL: {error}")
    except DBAPIError as error:
        _refuse(f"the database cannot be used: {error.orig}", CANNOT_START)
    except BaseError as error:
        _refuse(f"the storage cannot be used: {error}", CANNOT_START)


def _refuse(message: str, code: int = BAD_ARGUMENTS) -> NoReturn:
    typer.echo(f"pvg-service: {message.splitlines()[0]}", err=True)
    sys.exit(code)


def _settings(**overrides: object) -> Settings:
    given = {name: value for name, value in overrides.items() if value is not None}
    try:
        settings = Settings.model_validate(Settings().model_dump() | given) if given else Settings()
    except ValidationError as error:
        first = error.errors()[0]
        where = "_".join(str(part) for part in first["loc"]).upper()
        message = message_of(first)
        _refuse(f"setting PVG_{where}: {message}" if where else message)
    return settings


@cli.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen at (PVG_HOST).")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen at; 0 picks one (PVG_PORT).")] = None,
    worker: Annotated[bool, typer.Option(help="Run a worker too; without, start `pvg-service worker`.")] = True,
) -> None:
    """Run the API with its worker and broker until stopped."""
    settings = _settings(host=host, port=port)
    if not (settings.listens_to_loopback_only or settings.allow_unauthenticated_network):
        _refuse(
            f"there are no keys, so only this machine may connect: {settings.host} is refused. Listen at 127.0.0.1, "
            "or set PVG_ALLOW_UNAUTHENTICATED_NETWORK=true where the network itself limits who can connect"
        )
    configure(settings.log_level)
    make_folders(settings)
    migrate_database(settings.database)
    # uvicorn sends the signal that stopped it once more: it must not end the process before its child is stopped
    signal.signal(signal.SIGTERM, _leave)
    child = WorkerProcess(settings) if worker else None
    try:
        if child:
            child.start()
        uvicorn.run(
            create_app(settings),
            host=settings.host,
            port=settings.port,
            log_config=None,
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=DRAIN_S,
        )
    except KeyboardInterrupt:
        pass
    finally:
        if child:
            child.stop()


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


@cli.command()
def worker() -> None:
    """Run a worker alone, beside an API that was started with --no-worker."""
    settings = _settings()
    make_folders(settings)
    command = worker_command(settings)
    os.execve(command[0], command, worker_environment(settings))  # noqa: S606 - so that signals reach Celery itself


@cli.command()
def migrate() -> None:
    """Bring the database to the version of this code."""
    settings = _settings()
    configure(settings.log_level)
    make_folders(settings)
    migrate_database(settings.database)


@cli.command()
def gc() -> None:
    """Remove what is past its retention, and files that no record names."""
    settings = _settings()
    configure(settings.log_level)
    services = make_services(settings)
    if not is_current(settings.database):
        _refuse("the database is not of this version; run `pvg-service migrate` first")
    services.reaper.expire()
    removed = services.reaper.collect()
    typer.echo(f"{removed} orphaned file(s) removed", file=sys.stderr)
