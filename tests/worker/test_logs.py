"""What a worker says at its start, before Celery has its logs set up, and of which job."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import structlog

from worker import stopping
from worker.runner import Runner

STARTED = """
from unittest import mock
from celery.signals import worker_init
from worker import lifeline
from worker.sandbox import SandboxServer
import {module} as app

class Told(Exception):
    pass

with mock.patch.object(lifeline, "die_with_starter"), mock.patch.object(SandboxServer, "_run", side_effect=Told):
    with mock.patch.object(app, "wait_for_weights", create=True), mock.patch("threading.excepthook"):
        with mock.patch("threading.Event.wait"):
            worker_init.send(sender=None)
"""


def ran(code: str, data_dir: Path) -> subprocess.CompletedProcess[str]:
    """A process of Python that has run so."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PVG_DATA_DIR": str(data_dir)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def logged(code: str, data_dir: Path) -> str:
    """What such a process writes to its log."""
    return ran(code, data_dir).stderr


@pytest.mark.parametrize("module", ["worker.app", "worker.previews.app"])
def test_a_worker_says_as_json_that_it_loads_before_it_does(module: str, tmp_path: Path) -> None:
    log = logged(STARTED.format(module=module), tmp_path)
    lines = [json.loads(line) for line in log.splitlines() if "loading what jobs need" in line]
    assert [(line["level"], line["logger"]) for line in lines] == [("info", "worker.sandbox.keeper")], log


WARNED = """
import runpy
import warnings
import billiard.util
import celery.bin.celery
from celery.signals import setup_logging

def main():
    warnings.warn("of the start")
    setup_logging.send(sender=None)
    billiard.util.error("a process of the pool has ended")

celery.bin.celery.main = main
runpy.run_module("{module}", run_name="__main__")
"""


ENDED = """
import runpy
import time
import billiard.pool
import celery.bin.celery
from celery.signals import setup_logging
from worker import stopping

def main():
    setup_logging.send(sender=None)
    pool = billiard.pool.Pool(1)
    for stop in (lambda: None, stopping.ask):
        stop()
        process = pool._pool[0]
        process.terminate()
        # until the pool has put another in its place, and that has begun
        while pool._pool[:1] in ([], [process]) or pool._pool[0].pid is None:
            time.sleep(0.05)
    pool.terminate()

celery.bin.celery.main = main
runpy.run_module("worker", run_name="__main__")
"""


def test_a_process_of_the_pool_that_ends_is_an_error_unless_its_worker_was_told_to_stop(tmp_path: Path) -> None:
    log = logged(ENDED, tmp_path)
    lines = [json.loads(line) for line in log.splitlines() if "exited with" in line]
    assert [line["level"] for line in lines[:2]] == ["error", "info"], log


STOPS = """
import runpy
import signal
import sys
from types import SimpleNamespace
import celery.apps.worker
import celery.bin.celery

sys.argv[1:] = ["worker", "--loglevel", "INFO"]

def main():
    celery.apps.worker.install_worker_term_handler(SimpleNamespace(hostname="here"))
    signal.raise_signal(signal.SIGTERM)

celery.bin.celery.main = main
runpy.run_module("{module}", run_name="__main__")
"""


@pytest.mark.parametrize("module", ["worker", "worker.previews"])
def test_a_worker_that_is_told_to_stop_says_nothing_beside_its_log(module: str, tmp_path: Path) -> None:
    done = ran(STOPS.format(module=module), tmp_path)
    assert (done.stdout, done.returncode) == ("", 0), done.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["worker", "--help"]])
@pytest.mark.parametrize("module", ["worker", "worker.previews"])
def test_what_is_asked_of_celery_itself_is_answered(module: str, arguments: list[str], tmp_path: Path) -> None:
    asked = f"import runpy, sys\nsys.argv[1:] = {arguments}\nrunpy.run_module({module!r}, run_name='__main__')"
    assert "Usage:" in ran(asked, tmp_path).stdout


@pytest.mark.parametrize("module", ["worker", "worker.previews"])
def test_what_celery_and_its_pool_warn_of_is_json_too(module: str, tmp_path: Path) -> None:
    log = logged(WARNED.format(module=module), tmp_path)
    told = [(line["level"], line["event"]) for line in map(json.loads, log.splitlines())]
    assert [level for level, _ in told] == ["warning", "error"][: len(told)], log
    assert "UserWarning: of the start" in told[0][1]
    # the one of previews has no processes
    assert [event for _, event in told[1:]] == ["a process of the pool has ended"] * (module == "worker")


def test_what_is_logged_before_a_job_is_claimed_names_no_job_of_before(monkeypatch: pytest.MonkeyPatch) -> None:
    def told_to_stop() -> None:
        raise stopping.StoppedError

    monkeypatch.setattr(stopping, "check", told_to_stop)
    structlog.contextvars.bind_contextvars(job="job_before", kind="transfer")
    with pytest.raises(stopping.StoppedError):
        Runner.run(object.__new__(Runner), "job_next")
    assert structlog.contextvars.get_contextvars() == {}
