"""Workers as children of `pvg-service serve`: started, started again when they die, and stopped with all they began."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import structlog

from service.queue import PREVIEW, QUEUES
from service.settings import Settings

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class WorkerKind:
    """A kind of worker: the module that is run, where its Celery app is, and the queues it takes from."""

    name: str
    module: str
    app: str
    queues: tuple[str, ...]
    concurrency: Callable[[Settings], int]
    options: tuple[str, ...] = ()


JOBS: Final = WorkerKind("jobs", "worker", "worker.app", QUEUES, lambda settings: settings.worker_concurrency)
PREVIEWS: Final = WorkerKind(
    *("previews", "worker.previews", "worker.previews.app", (PREVIEW,), lambda settings: settings.preview_concurrency),
    options=("--pool", "threads"),
)
#: all that a service needs, each a process of its own beside the API
KINDS: Final = (JOBS, PREVIEWS)


def worker_command(settings: Settings, kind: WorkerKind = JOBS) -> list[str]:
    """A worker's command line.

    ``-P`` keeps the current folder out of the import path: a package called `worker` there would run instead.
    """
    return [
        *(sys.executable, "-P", "-m", kind.module, "--quiet", "-A", kind.app, "worker"),
        *("--queues", ",".join(kind.queues), "--concurrency", str(kind.concurrency(settings)), *kind.options),
        *("--hostname", f"pvg-{kind.name}-{os.getpid()}@%h", "--loglevel", settings.log_level),
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

    def __init__(self, settings: Settings, kind: WorkerKind = JOBS) -> None:
        self._settings = settings
        self._kind = kind
        self._stop = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._run, name=f"worker-keeper-{kind.name}", daemon=True)

    def start(self) -> None:
        """Start the worker."""
        self._thread.start()

    def begin_to_stop(self) -> None:
        """Tell the worker to stop, and return at once."""
        self._stop.set()

    def stop(self) -> None:
        """Stop the worker and every process it began."""
        self.begin_to_stop()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                process = self._spawn()
            except OSError as error:  # no memory or no processes, for a while
                log.error("the worker cannot be started, trying again", kind=self._kind.name, error=error.strerror)
                self._stop.wait(self._settings.worker_restart_delay_s or 0.1)
                continue
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
            worker_command(self._settings, self._kind),
            env=environment,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
        )
        log.info("worker started", kind=self._kind.name, worker_pid=process.pid)
        return process

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        _signal_group(process.pid, signal.SIGTERM, leader_only=True)
        try:
            process.wait(self._settings.worker_stop_limit_s + 1)
        except subprocess.TimeoutExpired:
            log.warning("the worker does not stop, killing it; its job will be taken up again")
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
