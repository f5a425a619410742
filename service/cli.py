"""`pvg-service`: serve, worker, health, keys, usage, migrate, gc, adopt."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Callable
from datetime import timedelta
from types import FrameType
from typing import Annotated

import structlog
import typer
from obstore.exceptions import BaseError
from sqlalchemy.exc import ArgumentError, DBAPIError, OperationalError
from sqlalchemy.orm import Session

from service import health
from service.catalog import ENDED, Key, keys, ledger, workers
from service.catalog.migrations import VersionError, has_table, is_current, migrate_to
from service.catalog.migrations import migrate as migrate_database
from service.catalog.models import Worker
from service.collector import HaltedError
from service.command_line import CANNOT_START, current_settings, open_records, read_settings, refuse, with_records
from service.key_commands import key_commands
from service.logs import configure
from service.outages import is_disk_full, is_outage, is_refusal
from service.processes import JOBS, KINDS, WorkerProcess, worker_command, worker_environment
from service.queue import make_folders
from service.room import Room
from service.settings import Settings
from service.version import VERSION

log = structlog.get_logger(__name__)

cli = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="The face colour transfer service.",
)

#: seconds that requests in flight get when the service stops; with what comes before and after, less than 20
DRAIN_S = 14
#: for a database that does not answer yet
START_WAIT_S = 30
#: versions of the tables before this one have no keys
_FIRST_WITH_KEYS = "0008"
_MONTH = re.compile(r"\d{4}-(0[1-9]|1[0-2])")


def main() -> None:
    """Entry point of the `pvg-service` command: a reason not to start is one line, not a traceback."""
    configure("INFO")  # what commands without a level of their own log is not their output
    try:
        cli()
    except OSError as error:
        where = f": {error.filename}" if error.filename is not None else ""
        refuse(f"{error.strerror or error}{where}", CANNOT_START)
    except ArgumentError as error:
        refuse(f"setting PVG_DATABASE_URL: {error}")
    except VersionError as error:
        refuse(str(error))
    except DBAPIError as error:
        refuse(f"the database cannot be used: {error.orig}", CANNOT_START)
    except BaseError as error:
        refuse(f"the storage cannot be used: {error}", CANNOT_START)


def _tell_version(asked: bool) -> None:
    if asked:
        typer.echo(f"pvg-service {VERSION}")
        raise typer.Exit


@cli.callback()
def _before(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@cli.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen at (PVG_HOST).")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen at; 0 picks one (PVG_PORT).")] = None,
    worker: Annotated[bool, typer.Option(help="Run the workers too; if not, start `pvg-service worker`.")] = True,
) -> None:
    """Run the API, with its workers and broker, until it is stopped."""
    settings = read_settings(host=host, port=port)
    may_listen = settings.listens_to_loopback_only or settings.allow_unauthenticated_network
    if not may_listen and not _have_keys(settings):
        refuse(
            f"there are no keys, so only this machine may connect: {settings.host} is refused. Make one with "
            "`pvg-service keys create NAME`, listen at 127.0.0.1, or set PVG_ALLOW_UNAUTHENTICATED_NETWORK=true where "
            "the network itself limits who can connect"
        )
    configure(settings.log_level)
    make_folders(settings)
    _once_it_answers(lambda: migrate_database(settings.database))
    # uvicorn sends the signal that stopped it once more: it must not end the process before its child is stopped
    signal.signal(signal.SIGTERM, _leave)
    children = [WorkerProcess(settings, kind) for kind in KINDS] if worker else []
    try:
        for child in children:
            child.start()
        from service.api import create_app, server  # noqa: PLC0415 - half of the start: the workers begin meanwhile

        settings = server.with_room(settings)
        app = create_app(settings)

        def stop() -> None:
            app.state.services.watch.close()
            for child in children:
                child.begin_to_stop()

        server.serve(app, settings, drain_s=DRAIN_S, on_stop=stop)
    except KeyboardInterrupt:
        pass
    finally:
        for child in children:
            child.begin_to_stop()
        for child in children:
            child.stop()


def _once_it_answers(step: Callable[[], None]) -> None:
    """Take a first step with the database; one that starts at the same moment, or is busy, is waited for."""
    until = time.monotonic() + START_WAIT_S
    while True:
        try:
            return step()
        except OperationalError as error:
            if not is_outage(error) or is_refusal(error) or time.monotonic() > until:
                raise
            log.warning("the database does not answer yet", reason=_first_line(error))
            time.sleep(1)


def _first_line(error: OperationalError) -> str:
    """What the database's driver says, which names no password."""
    return str(error.orig).strip().partition("\n")[0]


def _have_keys(settings: Settings) -> bool:
    """True when there are keys; a database that is not there yet has none, and is not made by asking."""
    return (
        _is_there(settings)
        and has_table(settings.database, Key.__tablename__)
        and with_records(settings, keys.exist, write=False)
    )


def _is_there(settings: Settings) -> bool:
    """False for a database of a file that is not there yet: asking would make it."""
    return settings.database_file is None or settings.database_file.exists()


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


_QUEUES = {",".join(kind.queues): kind for kind in KINDS}


@cli.command()
def worker(
    queues: Annotated[str, typer.Option(help=f"Which work it does: {' or '.join(_QUEUES)}.")] = ",".join(JOBS.queues),
) -> None:
    """Run one worker, for an API that was started with --no-worker."""
    if queues not in _QUEUES:
        refuse(f"--queues is {' or '.join(_QUEUES)}")
    settings = read_settings()
    make_folders(settings)
    _await_tables(settings)
    command = worker_command(settings, _QUEUES[queues])
    os.execve(command[0], command, worker_environment(settings))  # noqa: S606 - so that signals reach Celery itself


def _await_tables(settings: Settings) -> None:
    """Wait for tables of this version, which an API or `migrate` makes: by others its jobs would fail for good.

    An outage it waits for at work.
    """
    until = time.monotonic() + START_WAIT_S
    while not _has_own_tables(settings):
        if time.monotonic() > until:
            refuse("the database's tables are not of this version; run `pvg-service migrate` with it")
        time.sleep(1)


def _has_own_tables(settings: Settings) -> bool:
    if not _is_there(settings):
        return False
    try:
        return is_current(settings.database)
    except OperationalError as error:
        if not is_outage(error) or is_refusal(error):
            raise
        log.warning("the database does not answer yet", reason=_first_line(error))
        return True


@cli.command("health")
def tell_health(
    worker: Annotated[
        bool, typer.Option("--worker", help="Check this machine's workers of jobs instead of the API.")
    ] = False,
    previews: Annotated[
        bool, typer.Option("--previews", help="Check this machine's workers of previews instead of the API.")
    ] = False,
) -> None:
    """Check whether this machine's API or workers are well. The exit code is 1 if not."""
    if worker and previews:
        refuse("ask for --worker or --previews")
    sys.exit(health.report(read_settings(), "jobs" if worker else "previews" if previews else "api"))


@cli.command()
def migrate(
    to: Annotated[
        str | None,
        typer.Option(
            metavar="VERSION", help="Version such as 0011. Going back to an older one deletes what it does not know."
        ),
    ] = None,
    open_to_all: Annotated[
        bool,
        typer.Option(
            "--open-to-all",
            help="Allow a version without keys although there are keys. Everything then becomes visible to everyone.",
        ),
    ] = False,
) -> None:
    """Bring the database to the version of this code, or to another known version."""
    settings = read_settings()
    configure(settings.log_level)
    make_folders(settings)
    if to is None:
        migrate_database(settings.database)
        return
    if has_table(settings.database, Worker.__tablename__):
        running = _workers_heard_of(settings)
        if running:
            refuse(f"{running} worker(s) are running: stop every process of the service first", CANNOT_START)
    if to < _FIRST_WITH_KEYS and not open_to_all and _have_keys(settings):
        refuse(
            f"there are keys, and a service of version {to} knows none: whoever reaches it sees and deletes what "
            "they have made. If that is meant, add --open-to-all",
            CANNOT_START,
        )
    migrate_to(settings.database, to)


def _workers_heard_of(settings: Settings) -> int:
    """How many workers have said lately, by the database's clock as they do, that they are alive."""
    with open_records(settings) as database, database.read() as session:
        return workers.heard_of(session, since=database.now() - timedelta(seconds=settings.silent_s))


@cli.command()
def gc(
    even_most: Annotated[
        bool, typer.Option("--even-most", help="Go on even if more than half of all files would be deleted.")
    ] = False,
) -> None:
    """Delete what is past its retention, and files that no record names."""
    from service.api import make_services  # noqa: PLC0415 - half of the start, and other commands do without

    settings = read_settings()
    make_folders(settings)
    Room(settings).give_back()  # without a page of room SQLite cannot be opened
    settings = current_settings()
    configure(settings.log_level)
    services = make_services(settings)
    left: list[str] = []
    deleted = _unless_full(services.reaper.clear, "expiry", left)
    try:
        orphans = _unless_full(lambda: services.collector.collect(even_most=even_most), "the search", left)
    except HaltedError as error:
        typer.echo(f"{deleted} file(s) removed", err=True)
        refuse(str(error), CANNOT_START)
    deleted += _unless_full(services.reaper.clear, "deletion", left)
    _unless_full(services.background.forget, "clearing the log of SQLite", left)
    typer.echo(f"{deleted} file(s) removed; {orphans} had no record", err=True)
    if left:
        refuse(f"the disk is full, not done: {', '.join(left)}; run it again once there is room", CANNOT_START)


def _unless_full(step: Callable[[], int | None], name: str, left: list[str]) -> int:
    """What a step counts. One for which a full disk has no room counts nothing, and is ``left``."""
    try:
        return step() or 0
    except (DBAPIError, OSError) as error:
        if not is_disk_full(error):
            raise
        left.append(name)
        return 0


@cli.command()
def adopt() -> None:
    """Make the files in the storage this database's, as after a restore. Files that it does not name will go."""
    from service.api import make_services  # noqa: PLC0415 - half of the start, and other commands do without

    services = make_services(current_settings())
    there, unknown = services.collector.adopt()
    typer.echo(f"the storage is this database's: {unknown} of {there} file(s) have no record and will go", err=True)


@cli.command()
def usage(
    month: Annotated[
        str | None, typer.Option(metavar="YYYY-MM", help="One month, in UTC; without it, all months.")
    ] = None,
) -> None:
    """List what was done for each key, by month, oldest first. A key sees the same of itself in `/usage`."""
    if month is not None and not _MONTH.fullmatch(month):
        refuse("--month is a year and a month, such as 2026-11")

    def lines(session: Session) -> list[str]:
        names = {key.id: key.name for key in keys.every(session)}
        return [_line_of(owner, names.get(owner, ""), one) for owner, one in ledger.every(session, month=month)]

    for line in with_records(current_settings(), lines, write=False):
        typer.echo(line)


def _line_of(owner: str, name: str, month: ledger.Month) -> str:
    """Of what was made before there were keys neither id nor name is known."""
    return "\t".join(
        (
            *(month.month, owner or "-", name or "-"),
            *(f"{month.jobs.get(state, 0)} {state}" for state in ENDED),
            *(f"{month.looks} looks", f"{month.frames} frames", f"{month.duration_s:.3f} s"),
            *(f"{month.uploads} uploads", f"{month.upload_bytes} bytes"),
        )
    )


cli.add_typer(key_commands, name="keys")
