from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from service.processes import KINDS, PREVIEWS, WorkerKind, WorkerProcess, worker_command, worker_environment
from service.settings import Settings

POISON = "raise SystemExit('imported from the current folder')\n"


@pytest.fixture
def poisoned(tmp_path: Path) -> Path:
    """A folder with packages of the same names as ours, and of libraries that the worker imports."""
    for name in ("worker", "service", "pvg", "celery", "structlog", "numpy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(POISON)
        (tmp_path / name / "__main__.py").write_text(POISON)
    return tmp_path


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_worker_imports_nothing_from_the_folder_it_is_started_in(
    poisoned: Path, tmp_path: Path, kind: WorkerKind
) -> None:
    settings = Settings(data_dir=tmp_path / "data")
    # Celery's own report loads the app and every module of tasks, as the worker does, and ends
    command = worker_command(settings, kind)
    report = [*command[: command.index(kind.app) + 1], "report"]
    done = subprocess.run(
        report, cwd=poisoned, env=worker_environment(settings), capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert ("worker.tasks" if kind is not PREVIEWS else "worker_pool: 'threads'") in done.stdout


def test_each_queue_has_one_kind_of_worker(tmp_path: Path) -> None:
    queues = [queue for kind in KINDS for queue in kind.queues]
    assert sorted(queues) == ["preview", "render", "vectorize"]
    command = worker_command(Settings(data_dir=tmp_path), PREVIEWS)
    assert command[command.index("--queues") + 1] == "preview"
    assert command[command.index("--pool") + 1] == "threads"


def test_the_command_line_leads_past_the_current_folder(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    assert worker_command(settings)[:4] == [sys.executable, "-P", "-m", "worker"]


def test_the_worker_finds_the_data_folder_and_reports_to_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ORT_DISABLE_TELEMETRY", "0")
    monkeypatch.setenv("PVG_LEASE_S", "40")
    environment = worker_environment(Settings(data_dir=Path("elsewhere")))
    assert environment["PVG_DATA_DIR"] == str(tmp_path / "elsewhere")
    assert environment["ORT_DISABLE_TELEMETRY"] == "1"
    assert environment["PYTHONSAFEPATH"] == "1"
    assert environment["PVG_LEASE_S"] == "40"
    assert environment["PATH"] == os.environ["PATH"]


def test_a_worker_that_cannot_be_started_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    worker = WorkerProcess(Settings(data_dir=tmp_path, worker_restart_delay_s=0.05))
    tried, began = [], threading.Event()

    def spawn() -> subprocess.Popen[bytes]:
        tried.append(1)
        if len(tried) < 3:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        began.set()
        return subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True)

    monkeypatch.setattr(worker, "_spawn", spawn)
    worker.start()
    assert began.wait(60)
    worker.stop()
    assert len(tried) == 3
