"""A worker whose broker stays away says so, and says nothing of a short outage."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
import redis
from kombu.exceptions import OperationalError

from service import health
from service.catalog import Message
from service.processes import KINDS, PREVIEWS, WorkerKind, worker_command, worker_environment
from service.queue import PREVIEW_TASK, TASK, make_producer, send
from service.settings import Settings
from tests.promises import Drill
from tests.service.fixtures import make_tables
from tests.service.servers import free_port, redis_server, stop
from tests.waiting import until
from worker import connection

#: the worker's module, with little patience
IMPATIENT = """
import runpy, sys
from worker import connection
connection.TOLERATED_S = 0.5
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""

#: the worker's module, each of whose jobs, or pictures, leaves a file and lasts until there is a file "end"
LASTING = """
import pathlib, runpy, sys, time
folder = pathlib.Path(sys.argv.pop(1))
class Lasting:
    def start(self): pass
    def stop(self): pass
    def run(self, job_id):
        try:
            (folder / f"{job_id}.begun").touch(exist_ok=False)
        except FileExistsError:  # a message that is delivered again
            return
        while not (folder / "end").exists():
            time.sleep(0.05)
    def take_turn(self):
        self.run(f"picture-{len(list(folder.iterdir()))}")
if sys.argv[1] == "worker":
    from worker import tasks
    tasks._runner = Lasting
else:
    from worker.previews import app
    lasting = Lasting()
    app._previewer = lambda: lasting
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_worker_goes_on_when_another_redis_takes_over_and_its_own_only_reads(
    kind: WorkerKind, tmp_path: Path, promise: Callable[..., Drill]
) -> None:
    drill = promise("R3", wanted="failover: the running job goes on, and others are taken within 30 s")
    began = tmp_path / "began"
    began.mkdir()
    with ExitStack() as stack:
        broker_url = stack.enter_context(redis_server(tmp_path))
        server = stack.enter_context(redis.Redis.from_url(broker_url))
        settings = Settings(data_dir=tmp_path / "data", broker_url=broker_url, worker_concurrency=2)
        make_tables(settings.database)
        command = [sys.executable, "-P", "-c", LASTING, str(began), kind.module, *worker_command(settings, kind)[4:]]
        environment = worker_environment(settings) | {"PVG_BROKER_URL": broker_url, "PVG_WORKER_CONCURRENCY": "2"}
        log = stack.enter_context((tmp_path / "log").open("wb"))
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        stack.callback(stop, process)
        stack.callback((began / "end").touch)
        said = (tmp_path / "log").read_text

        def sent(name: str) -> None:
            producer = make_producer(settings)
            send(producer, Message(name, kind.queues[-1]), PREVIEW_TASK if kind is PREVIEWS else TASK)

        def at_work() -> int:
            assert process.poll() is None, said()
            return len(list(began.iterdir()))

        sent("first")
        until(lambda: at_work() == 1, 120, said=said)
        time.sleep(1)  # it waits for the next message
        server.replicaof("127.0.0.1", str(free_port()))
        time.sleep(5)
        with pytest.raises(OperationalError, match="read only"):
            sent("nobody's")
        server.replicaof("NO", "ONE")
        back = time.monotonic()
        sent("second")
        until(lambda: at_work() == 2, 60, said=said)
        taken_s = time.monotonic() - back
        # and when jobs end in such a time: their messages stay where they are
        server.replicaof("127.0.0.1", str(free_port()))
        (began / "end").touch()
        time.sleep(3)
        server.replicaof("NO", "ONE")
        for number in range(3, 6):
            sent(f"number-{number}")
            until(lambda number=number: at_work() == number + 1, 60, said=said)  # with the file "end"
        process.terminate()
        assert process.wait(60) == 0
        assert 0 < said().count("read only replica") < 10
        assert "Frequent restarts" not in said()
    drill.measured = f"{kind.name}: taken {taken_s:.1f} s after there was a Redis that writes"
    drill.keep_to(taken_s, 30)


def test_a_busy_worker_notices_each_time_that_its_broker_is_lost(tmp_path: Path) -> None:
    """Its only slot is taken while Redis goes away, again and again: it is the acknowledgement that fails."""
    port, began = free_port(), tmp_path / "began"
    broker_url = f"redis://127.0.0.1:{port}/0"
    began.mkdir()
    settings = Settings(data_dir=tmp_path / "data", broker_url=broker_url, worker_concurrency=1)
    make_tables(settings.database)
    kind = KINDS[0]
    command = [sys.executable, "-P", "-c", LASTING, str(began), kind.module, *worker_command(settings, kind)[4:]]
    environment = worker_environment(settings) | {"PVG_BROKER_URL": broker_url, "PVG_WORKER_CONCURRENCY": "1"}
    with ExitStack() as stack:
        log = stack.enter_context((tmp_path / "log").open("wb"))
        broker = stack.enter_context(ExitStack())
        broker.enter_context(redis_server(tmp_path, port))
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        stack.callback(stop, process)
        stack.callback((began / "end").touch)
        said = (tmp_path / "log").read_text
        for outage in range(3):
            (began / "end").unlink(missing_ok=True)
            send(make_producer(settings), Message(f"number-{outage}", kind.queues[-1]), TASK)
            until(lambda outage=outage: (began / f"number-{outage}.begun").exists(), 120, said=said)
            broker.close()
            (began / "end").touch()
            until(lambda outage=outage: said().count("Couldn't ack") > outage, 60, said=said)
            broker.enter_context(redis_server(tmp_path, port))
        assert said().count("Connection to broker lost") >= 2


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_worker_without_its_broker_is_not_well_until_the_broker_is_there(kind: WorkerKind, tmp_path: Path) -> None:
    port = free_port()
    broker_url = f"redis://127.0.0.1:{port}/0"
    settings = Settings(data_dir=tmp_path / "data", broker_url=broker_url, heartbeat_s=0.2, worker_concurrency=1)
    make_tables(settings.database)
    command = [sys.executable, "-P", "-c", IMPATIENT, kind.module, *worker_command(settings, kind)[4:]]
    given = {name: str(getattr(settings, name)) for name in ("broker_url", "heartbeat_s")}
    environment = worker_environment(settings) | {f"PVG_{name.upper()}": value for name, value in given.items()}
    part: health.Kind = "previews" if kind is PREVIEWS else "jobs"

    def is_well() -> bool:
        return health.of_workers(settings, part)[0]

    with ExitStack() as stack:
        log = stack.enter_context((tmp_path / "log").open("wb"))
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        stack.callback(stop, process)
        said = (tmp_path / "log").read_text
        until(lambda: health.of_workers(settings, part) == (False, "no broker"), 240, said=said)
        with redis_server(tmp_path, port):
            until(is_well, 120, said=said)
        until(lambda: health.of_workers(settings, part) == (False, "no broker"), 120, said=said)
        with redis_server(tmp_path, port):
            until(is_well, 120, said=said)


def test_a_minute_is_tolerated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A broker that is away for 60 s loses nothing."""
    now = 1000.0
    monkeypatch.setattr("worker.connection.time.monotonic", lambda: now)
    assert not connection.is_missed()
    connection.lose()
    now += 60
    connection.lose()  # tells nothing new
    assert not connection.is_missed()
    now += 1
    assert connection.is_missed()
    connection.find()
    assert not connection.is_missed()
