"""`pvg-service health` beside real processes: what it says, and what it costs."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from service import health
from service.catalog import Database, workers
from service.settings import Settings
from tests.service.fixtures import FakeClock
from tests.service.servers import free_port
from tests.waiting import until
from tests.worker.serving import started

COMMAND = str(Path(sys.executable).with_name("pvg-service"))


def asked(data_dir: Path, *arguments: str, **settings: str) -> tuple[int, str]:
    """Exit status and the one line of `pvg-service health`."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PVG_")}
    environment |= {"PVG_DATA_DIR": str(data_dir)} | settings
    done = subprocess.run(
        [COMMAND, "health", *arguments], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
    return done.returncode, done.stdout.strip()


@pytest.fixture
def api(tmp_path: Path) -> Iterator[tuple[Path, int]]:
    """An API alone; its data folder and port."""
    data_dir, log, port = tmp_path / "data", tmp_path / "log", free_port()
    with started([COMMAND, "serve", "--no-worker"], data_dir, log, port=str(port)) as process:

        def is_alive() -> bool:
            assert process.poll() is None, log.read_text()
            try:
                return httpx.get(f"http://127.0.0.1:{port}/livez").is_success
            except httpx.TransportError:
                return False

        until(is_alive, 180, said=log.read_text)
        yield data_dir, port


def test_of_the_api(api: tuple[Path, int]) -> None:
    data_dir, port = api
    assert asked(data_dir, PVG_PORT=str(port)) == (0, "degraded: workers none")
    assert asked(data_dir, PVG_PORT=str(port), PVG_HOST="0.0.0.0") == (0, "degraded: workers none")
    status, line = asked(data_dir, PVG_PORT=str(free_port()))
    assert (status, line.split(":")[0]) == (1, "no answer at 127.0.0.1")
    (data_dir / "blobs").rename(data_dir / "elsewhere")
    (data_dir / "blobs").write_text("no folder")  # the storage does not answer
    # what was found is told for KEEP_S more
    line = until(lambda: (said := asked(data_dir, PVG_PORT=str(port)))[0] == 1 and said[1], 120)
    assert str(line).startswith("unavailable: storage unavailable")


def test_of_workers_on_each_database(database: Database, clock: FakeClock, tmp_path: Path) -> None:
    settings = Settings(database_url=database.url, data_dir=tmp_path, heartbeat_s=60, lease_s=300)
    host = socket.gethostname()
    assert health.of_workers(settings, "jobs") == (False, f"no worker of jobs on {host}")
    with database.write() as session:
        workers.beat(session, "another-machine-7", now=clock())
        workers.beat(session, f"{host[:60]}-12", now=clock(), kind="previews")
    assert not health.of_workers(settings, "jobs")[0]
    assert health.of_workers(settings, "previews")[0]
    with database.write() as session:
        workers.beat(session, f"{host[:60]}-13", now=clock(), lacks="network weights")
    assert health.of_workers(settings, "jobs") == (False, "no network weights")
    with database.write() as session:
        workers.beat(session, f"{host[:60]}-14", now=clock())
    well, line = health.of_workers(settings, "jobs")
    assert well, line
    assert line.startswith("ok: 1 alive, heard of ")
    with database.write() as session:
        for number in (13, 14):
            late = clock() - timedelta(seconds=settings.silent_s + 60)
            workers.beat(session, f"{host[:60]}-{number}", now=late)
    well, line = health.of_workers(settings, "jobs")
    assert (well, line.split(" for ")[0]) == (False, "silent")


@pytest.mark.parametrize("host", ["node", "a_%"])
def test_a_machine_whose_name_begins_the_same_is_another(
    host: str, database: Database, clock: FakeClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: host)
    settings = Settings(database_url=database.url, data_dir=tmp_path, heartbeat_s=60, lease_s=300)
    with database.write() as session:
        workers.beat(session, f"{host[:56]}-2-1234", now=clock())
    assert health.of_workers(settings, "jobs") == (False, f"no worker of jobs on {host}")
    with database.write() as session:
        workers.beat(session, f"{host[:60]}-1234", now=clock())
    assert health.of_workers(settings, "jobs")[0]


def test_a_database_that_is_away_is_said(tmp_path: Path) -> None:
    assert asked(tmp_path, "--worker")[0] == 1
    assert not (tmp_path / "catalog.sqlite3").exists(), "asking makes no database"
    away = f"postgresql://u:secret@127.0.0.1:{free_port()}/d"
    status, line = asked(tmp_path, "--previews", PVG_DATABASE_URL=away)
    assert status == 1
    assert line.startswith("the database cannot be asked")
    assert "secret" not in line


def test_a_worker_is_silent_after_three_beats() -> None:
    assert Settings(heartbeat_s=7).silent_s == 21


def test_it_is_in_the_help_and_refuses_two_parts(tmp_path: Path) -> None:
    environment = os.environ | {"PVG_DATA_DIR": str(tmp_path)}
    done = subprocess.run(
        [COMMAND, "health", "--worker", "--previews"], env=environment, capture_output=True, check=False
    )
    assert done.returncode == 2
    done = subprocess.run([COMMAND, "health", "--help"], env=environment, capture_output=True, text=True, check=True)
    assert "--previews" in done.stdout


def test_it_loads_little() -> None:
    """Of the service the settings alone: no API, no records, no broker, none of the method."""
    script = (
        "import sys; sys.argv = ['pvg-service', 'health', '--worker']\n"
        "import pvg_service\n"
        "try: pvg_service.main()\n"
        "except SystemExit: pass\n"
        "print(*sorted({name.split('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert not loaded & {"sqlalchemy", "fastapi", "celery", "kombu", "typer", "httpx", "numpy", "cv2", "pvg", "worker"}
