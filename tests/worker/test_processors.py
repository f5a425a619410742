"""A worker starts no more threads, and gives its jobs no more processor time, than its container grants it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pvg import _processors
from service.settings import Settings
from worker.run import Run

THREADS = """
import os
from pvg import _processors
os.cpu_count, os.sched_getaffinity = lambda: 64, lambda _: set(range({affinity}))
_processors._quota = lambda _: {quota}
import {module}
print(os.environ["NUMBA_NUM_THREADS"], os.environ["OPENCV_FOR_THREADS_NUM"])
"""


@pytest.mark.parametrize(("affinity", "quota"), [(64, 6), (6, 64)])
@pytest.mark.parametrize(("module", "threads"), [("worker.app", "3 3"), ("worker.previews.app", "6 6")])
def test_threads_are_those_that_affinity_and_quota_grant(
    module: str, threads: str, affinity: int, quota: int, tmp_path: Path
) -> None:
    inherited = {name: value for name, value in os.environ.items() if not name.endswith(("_THREADS", "_THREADS_NUM"))}
    said = subprocess.run(
        [sys.executable, "-c", THREADS.format(module=module, affinity=affinity, quota=quota)],
        env=inherited | {"PVG_DATA_DIR": str(tmp_path), "PVG_WORKER_CONCURRENCY": "2"},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert said.stdout.strip() == threads


def test_a_job_has_the_time_of_the_processors_that_are_granted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)))
    monkeypatch.setattr(_processors, "_quota", lambda _: 12)
    given: list[float] = []

    def call(*_: Any, limits: Any, **__: Any) -> None:
        given.append(limits.cpu_s)

    run = object.__new__(Run)
    run.settings, run.began = Settings(data_dir=tmp_path, job_soft_limit_s=100), 0.0
    run.sandbox = cast(Any, SimpleNamespace(call=call))
    run.keeper, run.progress = cast(Any, SimpleNamespace(check=None)), cast(Any, None)
    run.call("render", {}, read=[], folder=tmp_path)
    assert given == [1201]
