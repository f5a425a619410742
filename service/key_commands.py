"""`pvg-service keys`: who may use the service over the network, and how much."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated, Final

import typer
from sqlalchemy.engine import make_url
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service.catalog import Key, amounts, keys
from service.catalog.belongings import Belongings
from service.catalog.keys import Limits
from service.catalog.migrations import has_table, migrate
from service.command_line import CANNOT_START, current_settings, open_records, read_settings, refuse, with_records
from service.erasure import open_erasure
from service.queue import make_folders
from service.settings import DAY_S, MAX_BYTES

MAX_KEY_NAME: Final = 100
#: what a server's column of an integer takes
MAX_COUNT: Final = 2**31 - 1
#: for which a former secret of a key may be good: long enough for who changes it by hand everywhere
MAX_OVERLAP_S: Final = 30 * DAY_S

key_commands = typer.Typer(no_args_is_help=True, help="Keys: who may use the service, and how much.")

KeyName = Annotated[str, typer.Argument(help="Name or id of the key.")]
Rate = Annotated[int, typer.Option(min=1, max=MAX_COUNT, help="Most requests a minute.")]
ActiveJobs = Annotated[int, typer.Option(min=1, max=MAX_COUNT, help="Most unfinished jobs.")]
StoredBytes = Annotated[int, typer.Option("--bytes", min=1, max=MAX_BYTES, help="Most bytes that it keeps.")]
_DEFAULTS = Limits()
_TIME: Final = "%Y-%m-%dT%H:%M:%SZ"


@key_commands.command("create")
def create_key(
    name: Annotated[str, typer.Argument(help="Name of the key, such as that of an application.")],
    rate: Rate = _DEFAULTS.requests_per_minute,
    active_jobs: ActiveJobs = _DEFAULTS.active_jobs,
    stored_bytes: StoredBytes = _DEFAULTS.stored_bytes,
) -> None:
    """Make a key and print it. It cannot be shown again. From the first key on, every call needs one."""
    if not 0 < len(name) <= MAX_KEY_NAME or not name.isprintable():
        refuse(f"a name has 1 to {MAX_KEY_NAME} printable characters")
    if name.startswith(("key_", "pvg_")):
        refuse("names do not begin as ids and keys do, with key_ or pvg_")
    settings = read_settings()
    make_folders(settings)
    is_new = not has_table(settings.database, Key.__tablename__)
    migrate(settings.database)
    limits = Limits(rate, active_jobs, stored_bytes)
    try:
        with open_records(settings) as database, database.write() as session:
            _, text = keys.create(session, name, limits, now=database.now())
    except IntegrityError:
        refuse(f"there is a key called {name}; `pvg-service keys rotate` gives it another secret")
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
    """List all keys with their limits and usage, and until when a former secret is valid. It shows no secrets.

    Columns have tabs between them; the last one is there only while a former secret is good.
    """
    with open_records(current_settings()) as database, database.read() as session:
        now = database.now()
        lines = [
            "\t".join(
                (
                    *(
                        key.id,
                        key.name,
                        "revoked" if key.revoked_at else "active",
                        f"{key.created_at:{_TIME}}",
                    ),
                    f"{key.requests_per_minute}/min",
                    f"{amounts.active_jobs(session, key.id)}/{key.active_jobs} jobs",
                    f"{amounts.stored_bytes(session, key.id)}/{key.stored_bytes} bytes",
                    *([f"former secret until {until:{_TIME}}"] if (until := keys.former_until(key, now=now)) else []),
                )
            )
            for key in keys.every(session)
        ]
    for line in lines:
        typer.echo(line)


@key_commands.command("revoke")
def revoke_key(name: KeyName) -> None:
    """End a key for good. What it owns stays until it expires, or until `assign` or `erase`."""
    with open_records(current_settings()) as database, database.write() as session:
        revoked = keys.revoke(session, _key(session, name), now=database.now())
    if not revoked:
        typer.echo(f"{name} was revoked before", err=True)


@key_commands.command("rotate")
def rotate_key(
    name: KeyName,
    overlap_s: Annotated[
        float, typer.Option(min=0, max=MAX_OVERLAP_S, help="Seconds for which the former secret stays valid.")
    ] = 0.0,
) -> None:
    """Give a key another secret and print that. The key keeps what it owns.

    The former one stops working, at once or after the overlap.
    """
    with open_records(current_settings()) as database, database.write() as session:
        until = database.now() + timedelta(seconds=overlap_s) if overlap_s else None
        text = keys.rotate(_active_key(session, name), former_until=until)
    typer.echo(text)


@key_commands.command("limit")
def limit_key(
    name: KeyName,
    rate: Annotated[int | None, typer.Option(min=1, max=MAX_COUNT, help="Most requests a minute.")] = None,
    active_jobs: Annotated[int | None, typer.Option(min=1, max=MAX_COUNT, help="Most unfinished jobs.")] = None,
    stored_bytes: Annotated[
        int | None, typer.Option("--bytes", min=1, max=MAX_BYTES, help="Most bytes that it keeps.")
    ] = None,
) -> None:
    """Change the limits of a key. Those that are not given stay."""

    def change(session: Session) -> None:
        key = _key(session, name)
        now = keys.limits_of(key)
        keys.limit(
            key,
            Limits(rate or now.requests_per_minute, active_jobs or now.active_jobs, stored_bytes or now.stored_bytes),
        )

    with_records(current_settings(), change)


@key_commands.command("assign")
def assign_to_key(
    name: KeyName,
    former: Annotated[str | None, typer.Option("--from", help="Name or id of the key that owns it now.")] = None,
) -> None:
    """Give a key what was made before there were keys, or, with --from, what another key owns."""

    def give(session: Session) -> tuple[int, int]:
        owner = keys.NOBODY if former is None else _key(session, former).id
        return keys.adopt(session, _active_key(session, name), owner=owner)

    given, left = with_records(current_settings(), give)
    typer.echo(f"{given} video(s) and reference(s) given, with their jobs and results", err=True)
    if left:
        typer.echo(f"{left} left, because {name} has the same bytes already", err=True)


@key_commands.command("erase")
def erase_key(
    name: KeyName,
    for_good: Annotated[
        bool, typer.Option("--for-good", help="Delete it. Without this, the command only says what there is.")
    ] = False,
) -> None:
    """Delete everything that a revoked key owns. The key's name and its counts by month stay."""
    settings = current_settings()
    owner = with_records(settings, lambda session: _revoked_key(session, name).id, write=False)
    with open_erasure(settings) as erasure:
        found = erasure.count(owner)
        if not for_good:
            refuse(f"{name} owns {_told(found)}. If all of that is to be deleted, add --for-good", CANNOT_START)
        erasure.erase_records(owner)
        gone, awaited = erasure.delete_files()
        typer.echo(f"{_told(found)} deleted; {gone} file(s) removed", err=True)
        if awaited:
            refuse(f"the storage has not deleted {awaited} file(s) yet; run it again", CANNOT_START)
        if left := erasure.count(owner):
            refuse(f"{name} owns {_told(left)} still; run it again", CANNOT_START)


def _told(found: Belongings) -> str:
    """In words, what an owner has."""
    return (
        f"{found.media} video(s) and reference(s), {found.results} result(s), {found.jobs} job(s), "
        f"{found.uploads} upload(s) in pieces, {found.deliveries} delivery(ies) of webhooks, "
        f"{found.answers} kept answer(s) and {found.previews} preview(s)"
    )


def _key(session: Session, name: str) -> Key:
    return keys.by_name(session, name) or refuse(f"there is no key {name}")


def _active_key(session: Session, name: str) -> Key:
    key = _key(session, name)
    return refuse(f"{name} was revoked, for good; make another key") if key.revoked_at else key


def _revoked_key(session: Session, name: str) -> Key:
    key = _key(session, name)
    return key if key.revoked_at else refuse(f"{name} is valid; `pvg-service keys revoke` ends it first")
