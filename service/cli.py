"""`pvg-service`: serve, worker, health, keys, migrate, gc, adopt."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from datetime import timedelta
from types import FrameType
from typing import Annotated, NoReturn, TypeVar

import structlog
import typer
from obstore.exceptions import BaseError
from pydantic import ValidationError
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, OperationalError
from sqlalchemy.orm import Session

from service import health
from service.catalog import Database, Key, keys, utc_now, workers
from service.catalog.keys import Limits
from service.catalog.migrations import VersionError, has_table, is_current, migrate_to
from service.catalog.migrations import migrate as migrate_database
from service.catalog.models import Worker
from service.collector import HaltedError
from service.errors import message_of
from service.logs import configure
from service.outages import is_outage
from service.processes import JOBS, KINDS, WorkerProcess, worker_command, worker_environment
from service.queue import make_folders
from service.settings import Settings

log = structlog.get_logger(__name__)

cli = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="The face colour transfer service.",
)

CANNOT_START = 1
BAD_ARGUMENTS = 2
#: seconds that requests in flight get when the service stops; with what comes before and after, less than 20
DRAIN_S = 14
#: for a database that does not answer yet
START_WAIT_S = 30
MAX_KEY_NAME = 100

Answer = TypeVar("Answer")


def main() -> None:
    """Entry point of the `pvg-service` command: a reason not to start is one line, not a traceback."""
    configure("INFO")  # what commands without a level of their own log is not their output
    try:
        cli()
    except OSError as error:
        where = f": {error.filename}" if error.filename is not None else ""
        _refuse(f"{error.strerror or error}{where}", CANNOT_START)
    except ArgumentError as error:
        _refuse(f"setting PVG_DATABASE_URL: {error}")
    except VersionError as error:
        _refuse(str(error))
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
    may_listen = settings.listens_to_loopback_only or settings.allow_unauthenticated_network
    if not may_listen and not _have_keys(settings):
        _refuse(
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
            if not is_outage(error) or time.monotonic() > until:
                raise
            log.warning("the database does not answer yet")
            time.sleep(1)


def _have_keys(settings: Settings) -> bool:
    """True when there are keys; a database that is not there yet has none, and is not made by asking."""
    return (
        _is_there(settings)
        and has_table(settings.database, Key.__tablename__)
        and _with_records(settings, keys.exist, write=False)
    )


def _is_there(settings: Settings) -> bool:
    """False for a database of a file that is not there yet: asking would make it."""
    return settings.database_file is None or settings.database_file.exists()


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


_QUEUES = {",".join(kind.queues): kind for kind in KINDS}


@cli.command()
def worker(
    queues: Annotated[str, typer.Option(help=f"What it does: {' or '.join(_QUEUES)}.")] = ",".join(JOBS.queues),
) -> None:
    """Run a worker alone, beside an API that was started with --no-worker."""
    if queues not in _QUEUES:
        _refuse(f"--queues is {' or '.join(_QUEUES)}")
    settings = _settings()
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
            _refuse("the database's tables are not of this version; run `pvg-service migrate` with it")
        time.sleep(1)


def _has_own_tables(settings: Settings) -> bool:
    if not _is_there(settings):
        return False
    try:
        return is_current(settings.database)
    except OperationalError as error:
        if not is_outage(error):
            raise
        log.warning("the database does not answer yet")
        return True


@cli.command("health")
def tell_health(
    worker: Annotated[bool, typer.Option("--worker", help="Of this machine's workers of jobs.")] = False,
    previews: Annotated[bool, typer.Option("--previews", help="Of this machine's workers of previews.")] = False,
) -> None:
    """Say whether the API at this machine's port, or a worker, is well; exit code 1 when it is not."""
    if worker and previews:
        _refuse("ask for --worker or --previews")
    sys.exit(health.report(_settings(), "jobs" if worker else "previews" if previews else "api"))


@cli.command()
def migrate(
    to: Annotated[
        str | None,
        typer.Option(metavar="VERSION", help="Such as 0011; an older one loses what is newer."),
    ] = None,
) -> None:
    """Bring the database to the version of this code, or to another one of which this code knows."""
    settings = _settings()
    configure(settings.log_level)
    make_folders(settings)
    if to is None:
        migrate_database(settings.database)
        return
    if has_table(settings.database, Worker.__tablename__):
        since = utc_now() - timedelta(seconds=settings.silent_s)
        running = _with_records(settings, lambda session: workers.heard_of(session, since=since), write=False)
        if running:
            _refuse(f"{running} worker(s) are running: stop every process of the service first", CANNOT_START)
    migrate_to(settings.database, to)


@cli.command()
def gc(
    even_most: Annotated[bool, typer.Option("--even-most", help="Though more than half of all files go.")] = False,
) -> None:
    """Remove what is past its retention, and files that no record names."""
    from service.api import make_services  # noqa: PLC0415 - half of the start, and other commands do without

    settings = _current_settings()
    configure(settings.log_level)
    services = make_services(settings)
    deleted = services.reaper.clear()
    try:
        orphans = services.collector.collect(even_most=even_most)
    except HaltedError as error:
        typer.echo(f"{deleted} file(s) removed", err=True)
        _refuse(str(error), CANNOT_START)
    deleted += services.reaper.clear()
    typer.echo(f"{deleted} file(s) removed; {orphans} had no record", err=True)


@cli.command()
def adopt() -> None:
    """Make the files of the storage this database's, as once a backup is restored: those it does not name will go."""
    from service.api import make_services  # noqa: PLC0415 - half of the start, and other commands do without

    services = make_services(_current_settings())
    there, unknown = services.collector.adopt()
    typer.echo(f"the storage is this database's: {unknown} of {there} file(s) have no record and will go", err=True)


key_commands = typer.Typer(no_args_is_help=True, help="Who may use the service over the network, and how much.")
cli.add_typer(key_commands, name="keys")

KeyName = Annotated[str, typer.Argument(help="The key's name, or its id.")]
Rate = Annotated[int, typer.Option(min=1, help="Requests a minute.")]
ActiveJobs = Annotated[int, typer.Option(min=1, help="Unfinished jobs.")]
StoredBytes = Annotated[int, typer.Option("--bytes", min=1, help="Bytes of media, assets and results.")]
_DEFAULTS = Limits()


@key_commands.command("create")
def create_key(
    name: Annotated[str, typer.Argument(help="A name for people, such as that of the application.")],
    rate: Rate = _DEFAULTS.requests_per_minute,
    active_jobs: ActiveJobs = _DEFAULTS.active_jobs,
    stored_bytes: StoredBytes = _DEFAULTS.stored_bytes,
) -> None:
    """Make a key and print it: it is shown only now. With the first one, every call needs a key."""
    if not 0 < len(name) <= MAX_KEY_NAME or not name.isprintable():
        _refuse(f"a name has 1 to {MAX_KEY_NAME} printable characters")
    if name.startswith(("key_", "pvg_")):
        _refuse("names do not begin as ids and keys do, with key_ or pvg_")
    settings = _settings()
    make_folders(settings)
    is_new = not has_table(settings.database, Key.__tablename__)
    migrate_database(settings.database)
    limits = Limits(rate, active_jobs, stored_bytes)
    try:
        _, text = _with_records(settings, lambda session: keys.create(session, name, limits, now=utc_now()))
    except IntegrityError:
        _refuse(f"there is a key called {name}; `pvg-service keys rotate` gives it another secret")
    # on a machine where the service runs with other settings, this is how one sees that the key is none of its own
    typer.echo(f"a key in {_named(settings.database)}", err=True)
    if is_new:
        typer.echo(
            "that database was made just now: a service that has run before has another one and stays open; then do "
            "this again in the folder, and with the PVG_… settings, that it runs with",
            err=True,
        )
    typer.echo(text)


def _named(database: str) -> str:
    """A database's URL without what is secret in it."""
    return make_url(database).set(query={}).render_as_string(hide_password=True)


@key_commands.command("list")
def list_keys() -> None:
    """All keys with their limits and what they use; secrets are not known here."""

    def lines(session: Session) -> list[str]:
        return [
            "\t".join(
                (
                    *(
                        key.id,
                        key.name,
                        "revoked" if key.revoked_at else "active",
                        f"{key.created_at:%Y-%m-%dT%H:%M:%SZ}",
                    ),
                    f"{key.requests_per_minute}/min",
                    f"{keys.active_jobs(session, key.id)}/{key.active_jobs} jobs",
                    f"{keys.stored_bytes(session, key.id)}/{key.stored_bytes} bytes",
                )
            )
            for key in keys.every(session)
        ]

    for line in _with_records(_current_settings(), lines, write=False):
        typer.echo(line)


@key_commands.command("revoke")
def revoke_key(name: KeyName) -> None:
    """End a key for good. What it owns stays until it expires, or until `assign` gives it to another."""
    if not _with_records(_current_settings(), lambda session: keys.revoke(session, _key(session, name), now=utc_now())):
        typer.echo(f"{name} was revoked before", err=True)


@key_commands.command("rotate")
def rotate_key(name: KeyName) -> None:
    """Give a key another secret and print it; the former one stops working, what the key owns stays its own."""
    typer.echo(_with_records(_current_settings(), lambda session: keys.rotate(_active_key(session, name))))


@key_commands.command("limit")
def limit_key(
    name: KeyName,
    rate: Annotated[int | None, typer.Option(min=1, help="Requests a minute.")] = None,
    active_jobs: Annotated[int | None, typer.Option(min=1, help="Unfinished jobs.")] = None,
    stored_bytes: Annotated[int | None, typer.Option("--bytes", min=1, help="Bytes of all it keeps.")] = None,
) -> None:
    """Change what a key may ask for and keep."""

    def change(session: Session) -> None:
        key = _key(session, name)
        now = keys.limits_of(key)
        keys.limit(
            key,
            Limits(rate or now.requests_per_minute, active_jobs or now.active_jobs, stored_bytes or now.stored_bytes),
        )

    _with_records(_current_settings(), change)


@key_commands.command("assign")
def assign_to_key(
    name: KeyName,
    former: Annotated[str | None, typer.Option("--from", help="A key to take everything from.")] = None,
) -> None:
    """Give a key what was made before there were keys, which nobody sees otherwise; or what another key has."""

    def give(session: Session) -> tuple[int, int]:
        owner = keys.NOBODY if former is None else _key(session, former).id
        return keys.adopt(session, _active_key(session, name), owner=owner)

    given, left = _with_records(_current_settings(), give)
    typer.echo(f"{given} video(s) and reference(s) given, with their jobs and results", err=True)
    if left:
        typer.echo(f"{left} left, because {name} has the same bytes already", err=True)


def _key(session: Session, name: str) -> Key:
    return keys.by_name(session, name) or _refuse(f"there is no key {name}")


def _active_key(session: Session, name: str) -> Key:
    key = _key(session, name)
    return _refuse(f"{name} was revoked, for good; make another key") if key.revoked_at else key


def _current_settings() -> Settings:
    settings = _settings()
    make_folders(settings)
    if not is_current(settings.database):
        _refuse("the database is not of this version; run `pvg-service migrate` first")
    return settings


def _with_records(settings: Settings, work: Callable[[Session], Answer], *, write: bool = True) -> Answer:
    database = Database(settings.database)
    try:
        with database.write() if write else database.read() as session:
            return work(session)
    finally:
        database.close()
