"""The process that the jobs' processes are forked from: everything they need is loaded, and it never sees a medium."""

from __future__ import annotations

import gc
import json
import os
import resource
import select
import signal
import socket
import tempfile
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from worker import lifeline
from worker.sandbox import child
from worker.sandbox.channel import send
from worker.sandbox.confinement import Limits, View, confine, program_folders

_PROBE_LIMITS = Limits(memory_bytes=2**40, cpu_s=600, file_bytes=2**20)


@dataclass
class _Job:
    """control: by which its supervisor is told of its end, and by closing which it is ended."""

    pid: int
    control: socket.socket


def serve(lobby: int, ready: int, calls_name: str, *, nice: int) -> None:
    """Load what jobs need, say so on the descriptor ``ready``, and fork a process for each request at ``lobby``.

    A request is two sockets: one for the supervisor to end the job and to be told of its end, which the job's process
    never has, and the job's own. Returns when every supervisor is gone.
    """
    lifeline.die_with_parent()
    for number in (signal.SIGINT, signal.SIGTERM):  # of the terminal, or to the whole group: supervisors decide
        signal.signal(number, signal.SIG_IGN)
    os.nice(nice)
    calls = import_module(calls_name)
    calls.preload()
    program_folders()  # kept for the children
    gc.collect()
    gc.freeze()  # pages of what is loaded stay shared
    lacking = missing()
    told = {"missing": lacking, "threads": len(os.listdir("/proc/self/task")) if os.path.exists("/proc") else 1}
    os.write(ready, json.dumps(told).encode())
    os.close(ready)
    with socket.socket(fileno=lobby) as entrance:
        _Server(entrance, calls, lacking).run()


def missing() -> list[str]:
    """What of the confinement this machine cannot do, a line each: tried in a process that ends with it."""
    with tempfile.TemporaryDirectory() as folder:  # which a confined process could not remove
        return _missing(Path(folder))


def _missing(folder: Path) -> list[str]:
    """The same, with a folder to be confined to."""
    reading, writing = os.pipe()
    parent = os.getpid()
    pid = os.fork()
    if pid == 0:
        try:
            lines = confine(_PROBE_LIMITS, View((), folder), parent=parent)
            os.write(writing, json.dumps(lines).encode())
        finally:
            os._exit(0)
    os.close(writing)
    with open(reading, "rb") as pipe:
        data = pipe.read()
    os.waitpid(pid, 0)
    found: list[str] = json.loads(data or b'["the attempt failed"]')
    return found


class _Server:
    def __init__(self, lobby: socket.socket, calls: ModuleType, lacking: Collection[str]) -> None:
        self._lobby = lobby
        self._calls = calls
        self._lacking = lacking
        self._jobs: dict[int, _Job] = {}  # by the descriptor of its control
        self._poll = select.poll()

    def run(self) -> None:
        woken, wake = socket.socketpair()
        for one in (woken, wake):
            one.setblocking(False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)
        waiting: dict[int, Callable[[], bool]] = {
            self._lobby.fileno(): self._admit,
            woken.fileno(): lambda: self._bury(woken),
        }
        for descriptor in waiting:
            self._poll.register(descriptor, select.POLLIN)
        going_on = True
        while going_on:
            for descriptor, _ in self._poll.poll():
                if descriptor in waiting:
                    going_on = waiting[descriptor]() and going_on
                elif descriptor in self._jobs:
                    self._end(self._jobs[descriptor])
        for job in self._jobs.values():
            os.kill(job.pid, signal.SIGKILL)

    def _admit(self) -> bool:
        """Fork a process for a request. False when nobody can ask any more."""
        data, descriptors, _, _ = socket.recv_fds(self._lobby, 1, 2)
        if not data:
            return False
        if len(descriptors) != 2:  # the supervisor has ended in the middle
            for one in descriptors:
                os.close(one)
            return True
        control, channel = descriptors
        parent = os.getpid()
        try:
            pid = os.fork()
        except OSError:  # for this moment; its supervisor sees both ends closed
            os.close(control)
            os.close(channel)
            return True
        if pid == 0:
            child.run(channel, self._calls, parent=parent, lacking=self._lacking)
        os.close(channel)
        self._jobs[control] = _Job(pid, socket.socket(fileno=control))
        self._poll.register(control, select.POLLIN)
        return True

    def _end(self, job: _Job) -> None:
        """The supervisor has closed its end, or is gone."""
        self._poll.unregister(job.control)
        os.kill(job.pid, signal.SIGKILL)  # not waited for yet, so it is nobody else's number

    def _bury(self, woken: socket.socket) -> bool:
        """Wait for those that have ended, and tell their supervisors."""
        woken.recv(4096)
        while self._jobs:
            pid, status, used = os.wait4(-1, os.WNOHANG)
            if pid == 0:
                break
            found = [one for one in self._jobs.values() if one.pid == pid]
            for job in found:
                del self._jobs[job.control.fileno()]
                self._tell(job, _end_of(status, used))
        return True

    def _tell(self, job: _Job, end: dict[str, Any]) -> None:
        with suppress(KeyError):  # it was ended
            self._poll.unregister(job.control)
        with job.control, suppress(OSError):  # the supervisor is gone
            send(job.control, end)


def _end_of(status: int, used: resource.struct_rusage) -> dict[str, Any]:
    return {
        "signal": os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0,
        "code": os.WEXITSTATUS(status) if os.WIFEXITED(status) else -1,
        "max_rss_bytes": used.ru_maxrss * 1024,
        "cpu_s": round(used.ru_utime + used.ru_stime, 3),
    }
