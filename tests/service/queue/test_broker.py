from __future__ import annotations

import os
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

from service.catalog import Message
from service.queue import RENDER, TASK, VECTORIZE, celery_settings, clear_remains, make_folders, make_producer, send
from service.queue import broker as broker_module
from service.queue.broker import sent_jobs, withdraw
from service.settings import Settings
from tests.side_by_side import at_once


def messages(settings: Settings) -> list[Path]:
    return sorted((settings.folder / "broker" / "messages").iterdir())


@pytest.fixture(params=["files", "redis"])
def broker(request: pytest.FixtureRequest, tmp_path: Path) -> Settings:
    """Settings of an empty broker, once of each kind."""
    url = "" if request.param == "files" else request.getfixturevalue("redis_url").replace("/0", "/7")
    settings = Settings(data_dir=tmp_path, broker_url=url)
    make_folders(settings)
    with make_producer(settings).connection_for_write() as connection, connection.channel() as channel:
        for name in (RENDER, VECTORIZE):
            channel.queue_purge(name)
    return settings


def take(settings: Settings, queue: str) -> list[str]:
    """The job ids of every message in a queue, in order."""
    ids = []
    producer = make_producer(settings)
    with producer.connection_for_read() as connection:
        bound = producer.amqp.queues[queue](connection.default_channel)
        while (message := bound.get()) is not None:
            assert message.headers["task"] == TASK
            ids.append(message.payload[0][0])
            message.ack()
    return ids


def test_messages_arrive_once_in_their_queue_and_in_order(broker: Settings) -> None:
    producer = make_producer(broker)
    for number in range(5):
        send(producer, Message(f"job_{number}", RENDER))
    send(producer, Message("job_v", VECTORIZE))
    assert take(broker, RENDER) == [f"job_{number}" for number in range(5)]
    assert take(broker, VECTORIZE) == ["job_v"]
    assert take(broker, RENDER) == []


def test_two_consumers_never_take_the_same_file(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    make_folders(settings)
    producer = make_producer(settings)
    for number in range(60):
        send(producer, Message(f"job_{number}", RENDER))
    taken = at_once([partial(take, settings, RENDER)] * 4)
    assert sorted(chain(*taken)) == sorted(f"job_{number}" for number in range(60))
    assert messages(settings) == []


def test_a_half_written_file_is_not_a_message(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    make_folders(settings)
    (settings.folder / "broker" / "messages" / "0001_x.render.draft").write_text('{"bo')
    assert take(settings, RENDER) == []


@pytest.mark.parametrize("content", [b"", bytes(100), b'{"bo'], ids=["empty", "zeros", "half"])
def test_a_message_that_a_power_cut_has_emptied_is_passed_over(tmp_path: Path, content: bytes) -> None:
    settings = Settings(data_dir=tmp_path)
    make_folders(settings)
    producer = make_producer(settings)
    for number in range(3):
        send(producer, Message(f"job_{number}", RENDER))
    for number in (0, 2):
        (settings.folder / "broker" / "messages" / f"job_{number}.render.msg").write_bytes(content)
    assert take(settings, RENDER) == ["job_1"]
    assert messages(settings) == []


def test_what_a_killed_process_leaves_of_a_message_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = Settings(data_dir=tmp_path)
    make_folders(settings)
    producer = make_producer(settings)
    for job_id in ("job_1", "job_2"):
        send(producer, Message(job_id, RENDER))
    half, taken = (tmp_path / "broker" / "messages" / name for name in ("x.draft", "job_1.render.msg.x.taken"))
    half.write_text('{"bo')
    os.utime(taken.with_name("job_1.render.msg"), (0, 0))  # it has waited for long, and is taken just now
    taken.with_name("job_1.render.msg").rename(taken)
    assert clear_remains(settings) == 0
    monkeypatch.setattr(broker_module, "_REMAINS_S", -1.0)
    assert clear_remains(settings) == 2
    assert [path.name for path in messages(settings)] == ["job_2.render.msg"]
    assert clear_remains(settings.model_copy(update={"broker_url": "redis://127.0.0.1:1/0"})) == 0


def test_the_settings_keep_the_promises_of_the_queue(tmp_path: Path) -> None:
    files: dict[str, Any] = celery_settings(Settings(data_dir=tmp_path))
    redis: dict[str, Any] = celery_settings(Settings(data_dir=tmp_path, broker_url="redis://localhost/0"))
    for conf in (files, redis):
        assert conf["accept_content"] == ["json"]
        assert conf["result_backend"] is None
        assert {queue.name for queue in conf["task_queues"]} == {"vectorize", "render", "preview"}
    assert files["broker_transport_options"]["polling_interval"] == 0.2
    longest = Settings().job_hard_limit_s
    assert redis["broker_transport_options"]["visibility_timeout"] > 2 * longest
    assert redis["broker_transport_options"]["unacked_restore_throttle"] == 1


def test_a_message_sent_twice_is_one_and_one_taken_back_is_none(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    make_folders(settings)
    producer = make_producer(settings)
    for number in (2, 0, 1, 1):
        send(producer, Message(f"job_{number}", RENDER))
    withdraw(settings, Message("job_0", RENDER))
    withdraw(settings, Message("job_9", RENDER))
    assert sent_jobs(settings, RENDER) == {"job_1", "job_2"}
    assert take(settings, RENDER) == ["job_1", "job_2"]  # the oldest job first
