from __future__ import annotations

import sqlite3
from pathlib import Path

import psycopg
import pytest
import structlog
from sqlalchemy import text
from sqlalchemy.exc import IntegrityError

from service.catalog import Database
from service.catalog.models import WebhookSecret
from tests.service.fixtures import make_tables
from tests.service.servers import fresh_database

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


def test_a_connection_that_comes_back_after_closing_is_closed(postgres_tables: str, postgres_url: str) -> None:
    with fresh_database(postgres_url, postgres_tables) as url:
        database = Database(url)
        with database.read() as session:
            connection = session.connection().connection.driver_connection
            database.close()
            assert session.execute(text("SELECT 1")).scalar_one() == 1
        assert isinstance(connection, psycopg.Connection)
        assert connection.closed
