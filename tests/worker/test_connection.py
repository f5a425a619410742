"""A worker whose broker stays away says so, and says nothing of a short outage."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from service import health
from service.processes import KINDS, PREVIEWS, WorkerKind, worker_command, worker_environment
from service.settings import Settings
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


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_worker_without_its_broker_is_not_well_until_the_broker_is_there(kind: WorkerKind, tmp_path: Path) -> None:
    port = free_port()
    broker_url = f"redis://127.0.0.1:{port}/0"
    settings = Settings(data_dir=tmp_path / "data", broker_url=broker_url, heartbeat_s=0.2, worker_concurrency=1)
    settings.folder.mkdir()
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
