"""A worker that cannot begin ends, so that it is started again; it takes no job to fail it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from service.processes import KINDS, WorkerKind, worker_command, worker_environment
from service.settings import Settings
from tests.service.fixtures import make_tables

#: the worker's module, whose fork server finds no library and ends at once
WITHOUT_FORKS = """
import runpy, sys
from worker.sandbox import keeper
keeper._SET["PYTHONHOME"] = "/nowhere"
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_worker_whose_fork_server_cannot_begin_ends(kind: WorkerKind, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data")
    make_tables(settings.database)
    command = [sys.executable, "-P", "-c", WITHOUT_FORKS, kind.module, *worker_command(settings, kind)[4:]]
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(command, env=worker_environment(settings), stdout=log, stderr=log)
        try:
            assert process.wait(120) == 1
        finally:
            process.kill()
            process.wait()
    said = (tmp_path / "log").read_text()
    assert "the worker cannot begin, and ends" in said
    assert " ready." not in said  # it has taken no job
