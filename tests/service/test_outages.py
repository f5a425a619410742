from __future__ import annotations

import errno
from pathlib import Path

import pytest
from kombu.exceptions import OperationalError as BrokerError
from obstore.exceptions import GenericError, NotFoundError
from psycopg import OperationalError as PsycopgError
from psycopg.errors import DiskFull
from sqlalchemy import select, text
from sqlalchemy.exc import OperationalError, SQLAlchemyError

from service.catalog import Database, Media, media
from service.outages import is_disk_full, is_locked, is_outage, is_partly_locked, is_refusal, told
from service.queue import make_producer
from service.settings import Settings
from service.storage import Storage
from tests.service.fixtures import add_media
from tests.service.remote import PRIVATE, answer, remote
from tests.service.s3 import S3
from tests.service.servers import free_port, wire_to


def met_lock(database: Database) -> SQLAlchemyError:
    """The error of who wants what another one has locked."""
    medium = add_media(database)
    other = Database(database.url, lock_wait_s=0.05)
    with database.write() as session:
        session.get(Media, medium.id, with_for_update=True)
        with pytest.raises(SQLAlchemyError) as caught, other.write() as second:
            media.get(second, medium.id, lock="update")
    other.close()
    return caught.value


def test_a_lock_that_is_not_had_in_time_is_an_outage_and_a_lock(database: Database) -> None:
    error = met_lock(database)
    assert is_locked(error)
    assert is_outage(error)


def test_only_a_server_is_locked_in_part(database: Database) -> None:
    assert is_partly_locked(met_lock(database)) == (not database.url.startswith("sqlite"))
    assert not is_partly_locked(ValueError())


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


def test_a_connection_that_is_lost_is_an_outage_and_a_statement_that_is_not_sent_is_none(postgres_url: str) -> None:
    """Neither has a state of the server's: it did not answer."""
    with wire_to(postgres_url) as (wire, url):
        database = Database(url)
        with database.read() as session:
            with pytest.raises(SQLAlchemyError, match="number of parameters") as caught:
                session.execute(select(Media.id).where(Media.id.in_(map(str, range(65_536)))))
            assert not is_outage(caught.value)
            session.rollback()
            session.execute(text("SELECT 1"))
            wire.cut()
            with pytest.raises(SQLAlchemyError) as caught:
                session.execute(text("SELECT 1"))
            assert is_outage(caught.value)
        database.close()


def test_a_store_that_fails_is_an_outage_and_a_missing_blob_is_none() -> None:
    assert is_outage(GenericError("connection refused"))
    assert not is_outage(NotFoundError("no such key"))
    assert not is_outage(ValueError())


@pytest.mark.parametrize(
    ("said", "refuses"),
    [
        ('FATAL:  password authentication failed for user "pvg"', True),
        ('FATAL:  database "pvg" does not exist', True),
        ("fe_sendauth: no password supplied", True),
        ("FATAL:  the database system is starting up", False),
        ("Connection refused", False),
    ],
)
def test_a_server_that_knows_no_such_user_or_database_is_not_waited_for(said: str, refuses: bool) -> None:
    orig = PsycopgError(f'connection failed: connection to server at "127.0.0.1", port 5432 failed: {said}')
    assert is_refusal(OperationalError("", None, orig)) == refuses


def test_the_log_says_why_a_broker_is_away(tmp_path: Path) -> None:
    producer = make_producer(Settings(data_dir=tmp_path, broker_url=f"redis://:secret@127.0.0.1:{free_port()}/0"))
    with pytest.raises(BrokerError) as caught, producer.connection_for_read() as connection:
        connection.ensure_connection(max_retries=1, timeout=2)
    assert told(caught.value) == {"error": "OperationalError", "reason": "Connection refused"}


_REFUSAL = b"""<?xml version="1.0" encoding="UTF-8"?>
<Error><Code>InvalidAccessKeyId</Code><AWSAccessKeyId>AKIAOURS</AWSAccessKeyId></Error>"""


def test_the_log_says_why_a_store_is_away_and_neither_where_nor_with_what_secret(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with remote(PRIVATE) as store:
        store.answers["/faces/source/lena.mp4"] = answer(_REFUSAL, "403 Forbidden")
        here, nobody = f"http://{PRIVATE}:{store.port}", f"http://{PRIVATE}:{free_port()}"
        for address, allowed, reason in (
            (here, "true", "403 Forbidden; InvalidAccessKeyId"),
            (here, "false", "HTTP error: builder error; http is allowed by AWS_ALLOW_HTTP=true alone"),
            (nobody, "true", "HTTP error: error sending request; connection refused"),
        ):
            for name, value in (S3(address).environment() | {"AWS_ALLOW_HTTP": allowed}).items():
                monkeypatch.setenv(name, value)
            away = Storage(Settings(data_dir=tmp_path, storage_url="s3://faces"))
            with pytest.raises(Exception, match="source/lena") as caught, away.local_path("source/lena.mp4"):
                pass
            assert is_outage(caught.value)
            assert told(caught.value) == {"error": type(caught.value).__name__, "reason": reason}
    assert told(ValueError("lena")) == {"error": "ValueError"}
    unknown = GenericError("Unable to open file /srv/lena.mp4 of key=AKIA1OURS")
    assert told(unknown)["reason"] == "Unable to open file … of …"


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
