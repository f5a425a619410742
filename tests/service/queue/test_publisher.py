from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy.orm import Session

from service.catalog import Database, Job, Media, Message, jobs
from service.queue import Publisher, make_folders
from service.queue import publisher as publisher_module
from service.queue.broker import sent_jobs
from service.settings import Settings
from tests.service.fixtures import add_media
from tests.waiting import until


class Counting(Database):
    """A database that counts its writing transactions."""

    writes = 0

    @contextmanager
    def write(self) -> Iterator[Session]:
        self.writes += 1
        with super().write() as session:
            yield session


@pytest.fixture
def broker(tmp_path: Path) -> Settings:
    settings = Settings(data_dir=tmp_path / "data")
    make_folders(settings)
    return settings


def queued(database: Database, count: int) -> list[Media]:
    return [add_media(database) for _ in range(count)]


def published(database: Database, found: list[Media]) -> int:
    with database.read() as session:
        return sum(session.get_one(Job, one.job_id).published_at is not None for one in found)


def publish(settings: Settings, database: Database, found: list[Media], pause_s: float = 0.0) -> None:
    with database.read() as session:
        messages = [jobs.message_of(session.get_one(Job, one.job_id)) for one in found]
    publisher = Publisher(settings, database)
    publisher.start()
    for message in messages:
        publisher.publish([message])
        time.sleep(pause_s)
    until(lambda: published(database, found) == len(found), 30)
    publisher.stop()


def test_what_comes_within_a_moment_is_marked_in_one_transaction(
    broker: Settings, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = queued(database, 20)
    monkeypatch.setattr(publisher_module, "_GATHER_S", 30.0)  # the machine may stand still meanwhile
    monkeypatch.setattr(publisher_module, "_BATCH", len(found))
    counting = Counting(database.url)
    publish(broker, counting, found, pause_s=0.005)
    counting.close()
    assert sent_jobs(broker, "vectorize") == {one.job_id for one in found}
    assert counting.writes < len(found) / 2


def test_a_message_alone_is_marked_as_well(broker: Settings, database: Database) -> None:
    publish(broker, database, queued(database, 1))


def test_what_waits_to_be_sent_is_not_queued_again(
    broker: Settings, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Message] = []
    monkeypatch.setattr(publisher_module, "send", lambda _, message: sent.append(message))
    messages = [Message(one.job_id, "vectorize") for one in queued(database, 2)]
    publisher = Publisher(broker, database)
    for _ in range(3):
        publisher.publish(messages)
    publisher.start()
    until(lambda: len(sent) == 2, 30)
    publisher.publish(messages[:1])  # it may be lost, once it is sent
    publisher.stop()
    until(lambda: len(sent) >= 3)  # it is not waited for long
    assert sent == [*messages, messages[0]]


def test_the_message_of_a_job_that_ends_meanwhile_is_taken_back(broker: Settings, database: Database) -> None:
    lives, ends = queued(database, 2)
    publisher = Publisher(broker, database)
    with database.read() as session:
        messages = [jobs.message_of(session.get_one(Job, one.job_id)) for one in (lives, ends)]
    with database.write() as session:
        assert jobs.cancel(session, ends.job_id, now=database.now())
    publisher.publish(messages)
    publisher.start()
    until(lambda: sent_jobs(broker, "vectorize") == {lives.job_id} and published(database, [lives]) == 1, 30)
    publisher.stop()
