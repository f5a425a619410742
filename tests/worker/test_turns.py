from __future__ import annotations

import threading

import pytest

from service.catalog import Database, Job, Message
from service.queue import VECTORIZE, make_folders, make_producer
from service.settings import Settings
from tests.service.fixtures import add_media, make_tables
from tests.service.queue.test_broker import take
from worker import runner as runner_module
from worker.runner import Runner
from worker.sandbox import Sandbox


def test_a_worker_takes_the_job_whose_turn_it_is_and_sends_the_message_of_the_other_again(
    settings: Settings,
) -> None:
    make_folders(settings)
    make_tables(settings.database)
    database = Database(settings.database)
    first, second = add_media(database, owner="key_a"), add_media(database, owner="key_a")
    other = add_media(database, owner="key_b")
    runner = Runner(settings, make_producer(settings), Sandbox(None))  # type: ignore[arg-type]

    def states() -> list[str]:
        with database.read() as session:
            return [session.get_one(Job, one.job_id).state for one in (first, second, other)]

    runner.run(first.job_id)  # there is no such file: a job that fails quickly
    assert states() == ["failed", "queued", "queued"]
    runner.run(second.job_id)
    assert states() == ["failed", "queued", "failed"]
    assert take(settings, VECTORIZE) == [second.job_id]
    with database.read() as session:
        assert session.get_one(Job, second.job_id).published_at is not None
    runner.run(other.job_id)
    runner.run(second.job_id)
    assert states() == ["failed"] * 3
    database.close()


def test_a_lease_is_kept_while_the_message_of_the_other_is_sent(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_folders(settings)
    make_tables(settings.database)
    database = Database(settings.database)
    first, named = add_media(database, owner="key_a"), add_media(database, owner="key_a")
    other = add_media(database, owner="key_b")
    runner = Runner(settings, make_producer(settings), Sandbox(None))  # type: ignore[arg-type]
    kept = list[bool]()

    def send(_: object, message: Message) -> None:
        assert message.job_id == named.job_id
        kept.append(f"lease-{other.job_id}" in {thread.name for thread in threading.enumerate()})

    monkeypatch.setattr(runner_module, "send", send)
    for one in (first, named):
        runner.run(one.job_id)
    assert kept == [True]
    database.close()
