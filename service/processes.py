"""The worker as a child of `pvg-service serve`: started, started again when it dies, and stopped with all it began."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import structlog

from service.queue import QUEUES
from service.settings import Settings

log = structlog.get_logger(__name__)


def worker_command(settings: Settings) -> list[str]:
    """The worker's command line.

    ``-P`` keeps the current folder out of the import path: a package called `worker` there would run instead.
    """
    return [
        *(sys.executable, "-P", "-m", "worker", "--quiet", "-A", "worker.app", "worker"),
        *("--queues", ",".join(QUEUES), "--concurrency", str(settings.worker_concurrency)),
        *("--hostname", f"pvg-{os.getpid()}@%h", "--loglevel", settings.log_level),
        # which workers there are and what they do is known from the database
        *("--without-gossip", "--without-mingle", "--without-heartbeat"),
    ]


def worker_environment(settings: Settings) -> dict[str, str]:
    """The worker's environment: this process's, and what must hold for the worker however it was started."""
    return {
        **os.environ,
        # the worker must find the same data folder, also one that came from an argument
        "PVG_DATA_DIR": str(settings.folder),
        # what the worker starts does not import from the current folder either
        "PYTHONSAFEPATH": "1",
        # onnxruntime reports to its maker unless this is set before it is loaded
        "ORT_DISABLE_TELEMETRY": "1",
    }


class WorkerProcess:
    """Keeps one worker running, in a session of its own so that a Ctrl-C reaches only the parent.

    The kernel kills the worker when the thread that started it ends, so that thread lives until `stop`.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._stop = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._run, name="worker-keeper", daemon=True)

    def start(self) -> None:
        """Start the worker."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the worker and every process it began."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            process = self._spawn()
            while process.poll() is None and not self._stop.wait(0.2):
                pass
            if self._stop.is_set():
                self._end(process)
                return
            log.error("the worker ended by itself, starting it again", code=process.returncode)
            _signal_group(process.pid, signal.SIGKILL)
            self._stop.wait(self._settings.worker_restart_delay_s)

    def _spawn(self) -> subprocess.Popen[bytes]:
        environment = worker_environment(self._settings) | {"PVG_STARTER_PID": str(os.getpid())}
        process = subprocess.Popen(
            worker_command(self._settings), env=environment, start_new_session=True, stdin=subprocess.DEVNULL
        )
        log.info("worker started", worker_pid=process.pid)
        return process

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        _signal_group(process.pid, signal.SIGTERM, leader_only=True)
        try:
            process.wait(self._settings.worker_stop_grace_s)
        except subprocess.TimeoutExpired:
            log.warning("the worker is still busy, killing it; its job will be taken up again")
        _signal_group(process.pid, signal.SIGKILL)
        process.wait()
        until = time.monotonic() + 5
        while _group_exists(process.pid) and time.monotonic() < until:
            time.sleep(0.05)


def _signal_group(leader: int, number: signal.Signals, *, leader_only: bool = False) -> None:
    try:
        if leader_only:
            os.kill(leader, number)
        else:
            os.killpg(leader, number)
    except ProcessLookupError:
        pass


def _group_exists(leader: int) -> bool:
    try:
        os.killpg(leader, 0)
    except ProcessLookupError:
        return False
    return True
