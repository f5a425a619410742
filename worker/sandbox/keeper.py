"""Keeps the fork server running beside the worker's main process."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from typing import Final

import structlog

log = structlog.get_logger(__name__)

#: what the server gets of the environment: where libraries, caches and its own code lie, and nothing else
_PASSED: Final = (
    *("HOME", "TMPDIR", "LANG", "LC_ALL", "TZ", "LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV"),
    *("PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX", "PVG_CACHE_DIR", "XDG_CACHE_HOME"),
    *("NUMBA_CACHE_DIR", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"),
    # which code of OpenBLAS runs: the last bits of a look depend on it, and are to be the library's own
    *("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"),
)
#: OpenBLAS would start its threads as it is loaded, and the method uses one anyway (docs/decisions/0010)
_SET: Final = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONSAFEPATH", "ORT_DISABLE_TELEMETRY"), "1"),
}
_CALLS: Final = "worker.sandbox.calls"
#: the work gives way to the API and the database of the same machine, which need little and are waited for
NICE: Final = 10
_AGAIN_S: Final = 0.5


class SandboxServer:
    """The fork server of one worker, whose processes are so ``nice`` to all others.

    `lobby`, once it is started, is where its supervisors ask for processes. It is started from a thread that lives as
    long as the worker, since the kernel ends it with the thread.
    """

    def __init__(self, label: str, calls: str = _CALLS, *, nice: int = NICE) -> None:
        self.pid = 0
        self._command = [str(nice), calls, label]
        self._ready = threading.Event()
        self._stop = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._run, name="sandbox-keeper", daemon=True)

    def start(self) -> None:
        """Start it and wait until it can serve. Raises `RuntimeError` when it ends before."""
        log.info("loading what jobs need; where kernels are not compiled yet, that takes up to two minutes")
        self.lobby, self._entrance = socket.socketpair()
        self._thread.start()
        self._ready.wait()
        if not self.pid:
            self.stop()
            raise RuntimeError("the process that jobs are forked from ends by itself; its reason is above")

    def stop(self) -> None:
        """End it, and all jobs with it."""
        self._stop.set()
        if self._process is not None:
            self._process.kill()
        self._thread.join()
        for end in (self.lobby, self._entrance):
            end.close()

    def _run(self) -> None:
        try:
            self._keep()
        finally:
            self._ready.set()  # if it never could begin, `start` says so

    def _keep(self) -> None:
        while not self._stop.is_set():
            try:
                self._serve()
            except OSError as error:  # no memory, processes or descriptors, for a while
                log.error("the process that jobs are forked from cannot be started", error=error.strerror)
            if not self.pid:
                return
            if not self._stop.wait(_AGAIN_S):
                log.error("the process that jobs are forked from has ended, starting it again", pid=self.pid)

    def _serve(self) -> None:
        reading, writing = os.pipe()
        entrance = self._entrance.fileno()
        given = [str(entrance), str(writing), *self._command]
        command = [sys.executable, "-P", "-m", "worker.sandbox", *given]
        with open(reading, "rb") as pipe:
            try:
                self._process = subprocess.Popen(
                    command, env=_environment(), stdin=subprocess.DEVNULL, pass_fds=(entrance, writing)
                )
            finally:
                os.close(writing)
            if self._stop.is_set():  # `stop` may have seen the process before this one, or none
                self._process.kill()
            told = pipe.read()  # it closes its end once it is ready, or when it ends
        if told:
            if not self._ready.is_set():
                _say(json.loads(told))
            self.pid = self._process.pid
            self._ready.set()
        self._process.wait()


def _environment() -> dict[str, str]:
    return {**{name: os.environ[name] for name in _PASSED if name in os.environ}, **_SET}


def _say(told: dict[str, object]) -> None:
    missing = told["missing"]
    if missing:
        log.warning("the sandbox of jobs is not whole on this machine (docs/security.md)", missing=missing)
    else:
        log.info("jobs run in a sandbox", has="limits, landlock, seccomp, network namespace")
    if told["threads"] != 1:
        log.warning("the process that jobs are forked from has threads", threads=told["threads"])
