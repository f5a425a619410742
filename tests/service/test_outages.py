from __future__ import annotations

import errno
from pathlib import Path

import pytest
from obstore.exceptions import GenericError, NotFoundError
from psycopg.errors import DiskFull
from sqlalchemy import text
from sqlalchemy.exc import OperationalError, SQLAlchemyError

from service.catalog import Database, Media, media
from service.outages import is_disk_full, is_locked, is_outage
from tests.service.fixtures import add_media


def test_a_lock_that_is_not_had_in_time_is_an_outage_and_a_lock(database: Database) -> None:
    medium = add_media(database)
    other = Database(database.url, lock_wait_s=0.05)
    with database.write() as session:
        session.get(Media, medium.id, with_for_update=True)
        with pytest.raises(SQLAlchemyError) as caught, other.write() as second:
            media.get(second, medium.id, lock="update")
    other.close()
    assert is_locked(caught.value)
    assert is_outage(caught.value)


def test_a_mistake_of_ours_is_no_outage(database: Database) -> None:
    with pytest.raises(SQLAlchemyError) as caught, database.read() as session:
        session.execute(text("SELECT nothing FROM nowhere"))
    assert not is_outage(caught.value)
    assert not is_locked(caught.value)


def test_a_database_that_is_not_there_is_an_outage(tmp_path: object) -> None:
    for url in ("postgresql+psycopg://pvg@127.0.0.1:1/none", f"sqlite:///{tmp_path}"):  # a folder cannot be opened
        database = Database(url)
        with pytest.raises(SQLAlchemyError) as caught:
            database.ping()
        assert is_outage(caught.value)
        assert not is_locked(caught.value)


def test_a_store_that_fails_is_an_outage_and_a_missing_blob_is_none() -> None:
    assert is_outage(GenericError("connection refused"))
    assert not is_outage(NotFoundError("no such key"))
    assert not is_outage(ValueError())


def test_a_full_disk_is_known_by_what_each_engine_says(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path}/full.sqlite3")
    with database.write() as session:
        session.execute(text("CREATE TABLE many (one TEXT)"))
        session.execute(text("PRAGMA max_page_count = 2"))
        with pytest.raises(SQLAlchemyError) as caught:
            session.execute(text("INSERT INTO many VALUES (:one)"), {"one": "x" * 100_000})
    database.close()
    assert is_disk_full(caught.value)
    assert not is_locked(caught.value)
    server = OperationalError("INSERT", None, DiskFull("could not extend file: No space left on device"))
    assert is_disk_full(server)
    assert is_disk_full(OSError(errno.EDQUOT, "quota"))
    assert not is_disk_full(OSError(errno.EIO, "broken"))
