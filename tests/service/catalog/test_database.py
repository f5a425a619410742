from __future__ import annotations

import math
import os
import secrets
import sqlite3
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import psycopg
import pytest
import structlog
from sqlalchemy import delete, select, text
from sqlalchemy.exc import IntegrityError, OperationalError, SQLAlchemyError

from service.catalog import Database, Media
from service.catalog.database import _OF_SESSIONS
from service.catalog.models import WebhookSecret
from service.outages import is_outage
from tests.service.fixtures import add_media, make_tables
from tests.service.servers import fresh_database, wire_to

SECRET = "whsec_which-no-log-may-have"


def test_a_failing_statement_is_logged_without_what_it_holds(
    database: Database, caplog: pytest.LogCaptureFixture
) -> None:
    row = WebhookSecret(owner="key_1", secret=SECRET)  # without the time that it must have
    try:
        with database.write() as session:
            session.add(row)
    except IntegrityError:
        structlog.get_logger().exception("a step failed")
    assert "INSERT INTO webhook_secrets" in caplog.text
    assert "created_at" in caplog.text, "the reason stays"
    assert SECRET not in caplog.text


def test_a_connection_waits_for_locks_as_before_though_what_is_removed_is_not_forgotten(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'catalog.sqlite3'}"
    make_tables(url)
    database = Database(url, lock_wait_s=7)

    def wait_ms() -> int:
        with database.read() as session:
            return int(session.execute(text("PRAGMA busy_timeout")).scalar_one())

    before = wait_ms()
    with database.read() as session:  # the one connection of the pool
        connection = session.connection().connection.driver_connection
    assert isinstance(connection, sqlite3.Connection)
    connection.set_authorizer(
        lambda _, name, *__: sqlite3.SQLITE_DENY if name == "wal_checkpoint" else sqlite3.SQLITE_OK
    )
    with pytest.raises(sqlite3.DatabaseError, match="not authorized"):
        database.forget()
    connection.set_authorizer(None)
    assert wait_ms() == before == 7000
    database.close()


@pytest.mark.parametrize("wholly", [True, False])
def test_no_copy_of_a_removed_row_stays_in_the_file_of_sqlite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, wholly: bool
) -> None:
    """`secure_delete` alone leaves some behind: in one of five files like these."""
    for number in range(20):
        url = f"sqlite:///{tmp_path / f'{number}.sqlite3'}"
        make_tables(url)
        database = Database(url)
        owners = [f"key_{secrets.token_hex(16)}" for _ in range(200)]
        with database.write() as session:
            session.add_all(WebhookSecret(owner=one, secret=SECRET, created_at=database.now()) for one in owners)
        database.forget()  # the first time it is due
        with database.write() as session:
            session.execute(delete(WebhookSecret).where(WebhookSecret.owner.in_(owners[::2])))
        with database.read() as session:
            pages = session.execute(text("PRAGMA page_count")).scalar_one()
        database.forget()
        with database.read() as session:
            assert session.execute(text("PRAGMA page_count")).scalar_one() == pages, "the next time in an hour"
        monkeypatch.setattr("service.catalog.database.time.monotonic", lambda: math.inf)
        database.forget(wholly=wholly)
        monkeypatch.undo()
        with database.read() as session:
            assert session.execute(text("PRAGMA page_count")).scalar_one() < pages
            assert session.scalars(select(WebhookSecret.owner)).all() == sorted(owners[1::2])
        database.close()
        content = b"".join(path.read_bytes() for path in tmp_path.glob(f"{number}.*"))
        assert [one for one in owners if one.encode() in content] == owners[1::2]


def _fill(database: Database, megabytes: int) -> None:
    numbers = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 1000 * :megabytes)"
    with database.write() as session:
        session.execute(text("CREATE TABLE filled (bytes BLOB)"))
        session.execute(text(f"{numbers} INSERT INTO filled SELECT randomblob(1000) FROM n"), {"megabytes": megabytes})


def _size(database: Database) -> int:
    with database.read() as session:
        return int(session.execute(text("PRAGMA page_count")).scalar_one())


def test_the_file_of_sqlite_is_written_anew_beside_it_and_not_in_a_folder_for_all(tmp_path: Path) -> None:
    """As a temporary file, of a name that is gone while it is written, so it is looked for among what is open."""
    (tmp_path / "of its own").mkdir()
    url = f"sqlite:///{tmp_path / 'of its own' / 'catalog.sqlite3'}"
    make_tables(url)
    database, places = Database(url), set[str]()
    _fill(database, 8)

    def look() -> int:
        for one in Path("/proc/self/fd").iterdir():
            with suppress(FileNotFoundError):
                places.add(os.readlink(one))
        return 0

    with database.read() as session:  # the one connection of the pool
        connection = session.connection().connection.driver_connection
    assert isinstance(connection, sqlite3.Connection)
    connection.set_progress_handler(look, 1000)
    database.forget(wholly=True)
    connection.set_progress_handler(None, 0)
    database.close()
    copies = {Path(place).parent for place in places if place.endswith(" (deleted)") and "etilqs_" in place}
    assert copies == {tmp_path / "of its own"}


def test_a_database_whose_folder_cannot_be_written_is_opened_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As it is before a disk becomes one that can only be read; SQLite refuses such a folder for its copies."""
    url = f"sqlite:///{tmp_path / 'catalog.sqlite3'}"
    make_tables(url)
    with monkeypatch.context() as patch:
        patch.setattr("service.catalog.database.Path.resolve", lambda _: Path("/proc/1/nowhere/catalog.sqlite3"))
        database = Database(url)
        assert _size(database)
        database.forget(wholly=True)
        database.close()


def test_the_file_of_sqlite_is_not_written_anew_where_that_would_fill_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    url = f"sqlite:///{tmp_path / 'catalog.sqlite3'}"
    make_tables(url)
    database, steady_s = Database(url), 0.0
    _fill(database, 2)
    database.forget()  # the first time it is due
    with database.write() as session:
        session.execute(text("DELETE FROM filled"))
    before, free = _size(database), 5_000_000
    monkeypatch.setattr("service.catalog.database.time.monotonic", lambda: steady_s)
    monkeypatch.setattr("service.catalog.database.shutil.disk_usage", lambda _: SimpleNamespace(free=free))
    steady_s = 1e9
    for _ in range(2):
        database.forget()
    assert _size(database) == before
    assert caplog.text.count("no room to write the file of SQLite anew") == 1, "and not in each round"
    free = 10_000_000
    database.forget()
    assert _size(database) == before, "it is looked again in an hour"
    steady_s += 3600
    database.forget()
    assert _size(database) < before
    database.close()


def test_a_file_of_sqlite_that_cannot_be_written_anew_is_an_error_of_the_database(tmp_path: Path) -> None:
    """So that a disk that fills meanwhile is told as such, by the reaper and by the commands."""
    url = f"sqlite:///{tmp_path / 'catalog.sqlite3'}"
    make_tables(url)
    database = Database(url)
    _fill(database, 2)
    with sqlite3.connect(tmp_path / "catalog.sqlite3", isolation_level=None) as other:
        other.execute("BEGIN IMMEDIATE")
        with database.read() as session:
            connection = session.connection().connection.driver_connection
        assert isinstance(connection, sqlite3.Connection)
        connection.execute("PRAGMA busy_timeout = 10")
        with pytest.raises(OperationalError) as raised:
            database.forget(wholly=True)
    other.close()
    database.close()
    assert is_outage(raised.value)


def test_a_machine_that_is_lost_in_a_transaction_keeps_no_row_locked(
    postgres_tables: str, postgres_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(_OF_SESSIONS, "idle_in_transaction_session_timeout", 1000)
    with fresh_database(postgres_url, postgres_tables) as url, wire_to(url) as (wire, far):
        near, lost = Database(url), Database(far)
        medium = add_media(near)
        had: list[Media | None] = []

        def be_away() -> None:
            with lost.write() as session:
                session.get(Media, medium.id, with_for_update=True)
                wire.hang()
                try:
                    with near.write() as other:
                        had.append(other.get(Media, medium.id, with_for_update=True))
                finally:
                    wire.connect()
                session.execute(text("SELECT 1"))

        with pytest.raises(SQLAlchemyError) as caught:
            be_away()
        assert len(had) == 1
        assert is_outage(caught.value)
        near.close()
        lost.close()


def test_a_server_looks_whether_a_session_is_still_there(postgres_url: str) -> None:
    database = Database(postgres_url)
    with database.read() as session:
        for name, value in _OF_SESSIONS.items():
            query = text("SELECT setting FROM pg_settings WHERE name = :name")
            assert session.execute(query, {"name": name}).scalar_one() == str(value)
    database.close()


def test_a_connection_that_comes_back_after_closing_is_closed(postgres_tables: str, postgres_url: str) -> None:
    with fresh_database(postgres_url, postgres_tables) as url:
        database = Database(url)
        with database.read() as session:
            connection = session.connection().connection.driver_connection
            database.close()
            assert session.execute(text("SELECT 1")).scalar_one() == 1
        assert isinstance(connection, psycopg.Connection)
        assert connection.closed
