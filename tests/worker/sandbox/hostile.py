"""What a job's process might do once a medium has taken it over: calls for a fork server of the tests."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import json
import mmap
import os
import signal
import socket
import stat
import struct
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

Progress = Callable[[str, int, int], None]


class MediaError(Exception):
    """As the method's own."""


class LibavError(OSError):
    """As libav's."""


LibavError.__module__ = "av.error"


def preload() -> None:
    pass


def begin() -> None:
    pass


def sockets() -> list[int]:
    """The channel alone, if all is well."""
    found = [int(name) for name in os.listdir("/proc/self/fd") if Path(f"/proc/self/fd/{name}").exists()]
    return [one for one in found if stat.S_ISSOCK(os.fstat(one).st_mode)]


def attempts(arguments: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Try everything; what of it was done, and what is seen."""
    folder, outside = Path(arguments["folder"]), Path(arguments["outside"])
    libc = ctypes.CDLL(None, use_errno=True)
    (folder / "made").write_text("own")

    def fork() -> None:
        if os.fork() == 0:
            os._exit(0)

    def run() -> None:
        os.execv("/bin/true", ["true"])

    def clone() -> None:
        if libc.fork() < 0:
            raise OSError

    def trace() -> None:
        if libc.ptrace(0, 0, 0, 0):
            raise OSError

    def unshare() -> None:
        if libc.unshare(0x1000_0000):
            raise OSError

    def use_semaphores() -> None:
        wanted = 66 if os.uname().machine == "x86_64" else 191
        if libc.syscall(wanted, 0, 0, 12, 0) < 0 and ctypes.get_errno() != errno.EINVAL:  # there are none
            raise OSError(ctypes.get_errno(), "semctl")

    def set_of_pipe(what: int, value: int | bytes) -> None:
        ends = os.pipe()
        try:
            fcntl.fcntl(ends[0], what, value)
        finally:
            for one in ends:
                os.close(one)

    def owner_by_ioctl(request: int) -> None:
        for descriptor in sockets():
            fcntl.ioctl(descriptor, request, struct.pack("i", arguments["supervisor"]))

    def outlive() -> None:
        if libc.prctl(1, 0, 0, 0, 0):
            raise OSError

    def map_memory(flags: int) -> None:
        mmap.mmap(-1, 2**20, flags=flags | mmap.MAP_ANONYMOUS)

    tries: dict[str, Callable[[], object]] = {
        "read another file": outside.read_bytes,
        "list another folder": lambda: list(outside.parent.iterdir()),
        "write another file": lambda: outside.write_bytes(b"x"),
        "change its input": lambda: Path(arguments["source"]).write_bytes(b"x"),
        "remove its input": lambda: Path(arguments["source"]).unlink(),
        **_tries_by_descriptor(arguments["source"]),
        "link out of its folder": lambda: (folder / "link").symlink_to(outside),
        "read the list of users": lambda: Path("/etc/passwd").read_bytes(),
        "read the server's environment": lambda: Path(f"/proc/{os.getppid()}/environ").read_bytes(),
        "open a socket of the Internet": lambda: socket.socket(socket.AF_INET),
        "open a socket of this machine": lambda: socket.socket(socket.AF_UNIX),
        "make a pair of sockets": socket.socketpair,
        "start a process": fork,
        "start a process in C": clone,
        "run a program": run,
        "trace": trace,
        "make a namespace": unshare,
        "read semaphores of others": use_semaphores,
        "end its supervisor": lambda: os.kill(arguments["supervisor"], signal.SIGTERM),
        **_tries_to_schedule(arguments["supervisor"]),
        "choose a signal": lambda: set_of_pipe(fcntl.F_SETSIG, signal.SIGTERM),
        "have its supervisor told": lambda: set_of_pipe(fcntl.F_SETOWN, arguments["supervisor"]),
        "have a thread told": lambda: set_of_pipe(15, struct.pack("ii", 1, arguments["supervisor"])),
        "have its supervisor told by FIOSETOWN": lambda: owner_by_ioctl(0x8901),
        "have its supervisor told by SIOCSPGRP": lambda: owner_by_ioctl(0x8902),
        "outlive the fork server": outlive,
        "end the fork server": lambda: os.kill(os.getppid(), 0),
        "have memory that is shared": lambda: map_memory(mmap.MAP_SHARED),
        "have memory that grows as a stack does": lambda: map_memory(mmap.MAP_PRIVATE | 0x100),
        "have memory in a file without a name": lambda: os.memfd_create("x"),
        "raise its limits": lambda: __import__("resource").setrlimit(9, (2**40, 2**40)),
    }
    done = []
    for name, attempt in tries.items():
        try:
            attempt()
        except (OSError, ValueError):
            continue
        done.append(name)
    thread = threading.Thread(target=progress, args=("thread", 1, 1))
    thread.start()
    thread.join()
    return {
        "done": done,
        "read": Path(arguments["source"]).read_text(),
        "environment": dict(os.environ),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "capabilities": [line for line in Path("/proc/self/status").read_text().splitlines() if "CapEff" in line],
        "networks": [line.split(":")[0].strip() for line in Path("/proc/self/net/dev").read_text().splitlines()[2:]],
    }


def _tries_by_descriptor(path: str) -> dict[str, Callable[[], object]]:
    def by_descriptor(change: Callable[[int], object]) -> None:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            change(descriptor)
        finally:
            os.close(descriptor)

    return {
        "change the mode of its input": lambda: by_descriptor(lambda one: os.fchmod(one, 0o666)),
        "change the owner of its input": lambda: by_descriptor(lambda one: os.fchown(one, -1, -1)),
        "note something on its input": lambda: by_descriptor(lambda one: os.setxattr(one, "user.x", b"x")),
        "take a note off its input": lambda: by_descriptor(lambda one: os.removexattr(one, "user.noted")),
    }


def _tries_to_schedule(pid: int) -> dict[str, Callable[[], object]]:
    def set_all() -> None:
        wanted = struct.pack("IIQiIQQQ", 48, os.SCHED_OTHER, 0, 0, 0, 0, 0, 0)  # `struct sched_attr`
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.syscall(314 if os.uname().machine == "x86_64" else 274, pid, wanted, 0):
            raise OSError

    own = os.sched_param(0)
    return {
        "pin its supervisor to cores": lambda: os.sched_setaffinity(pid, os.sched_getaffinity(pid)),
        "put its supervisor behind others": lambda: os.sched_setscheduler(pid, os.SCHED_OTHER, own),
        "set the priority of its supervisor": lambda: os.sched_setparam(pid, own),
        "set all of how its supervisor is scheduled": set_all,
    }


def act(arguments: Mapping[str, Any], progress: Progress) -> dict[str, Any]:  # noqa: PLR0912
    """Do what the medium says, with the arguments of a vectorisation."""
    what, _, rest = Path(arguments["source"]).read_text().partition(" ")
    if what == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif what == "sleep":
        time.sleep(600)
    elif what == "spin":
        while True:
            pass
    elif what == "eat":
        held = []
        while True:
            held.append(bytearray(2**27))
    elif what == "write":
        with Path(arguments["asset"]).open("wb") as file:
            while True:
                file.write(bytes(2**20))
    elif what == "babble":
        for descriptor in range(3, 64):  # whichever is the channel
            try:
                os.write(descriptor, struct.pack(">I", 2**31) + b"{")
            except OSError:
                continue
        time.sleep(60)
    elif what == "fail":  # to read its file
        library, number = rest.split()
        failed = (LibavError if library == "libav" else OSError)(int(number), os.strerror(int(number)))
        raise MediaError(f"{arguments['source']} cannot be read: {failed.strerror}") from failed
    elif what == "raise":
        raise RuntimeError("/srv/secret")
    elif what == "answer":
        if "no file" not in rest:
            Path(arguments["asset"]).write_bytes(b"asset")
            Path(arguments["pictures"]).write_bytes(b"poster")
        answer: dict[str, Any] = json.loads(rest.removesuffix("no file"))
        return answer
    return {}


def stay(arguments: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Answer what is asked, in one process; what it is asked to do may be bad."""
    kept = Path(arguments["source"]).read_text()

    def answer_to(question: Mapping[str, Any]) -> dict[str, Any]:
        if "read" in question:
            return {"read": Path(question["read"]).read_text()}
        if question.get("what") == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if question.get("what") == "hang":
            time.sleep(60)
        return {"pid": os.getpid(), "kept": kept}

    return answer_to


CALLS = {"attempts": attempts, "vectorize": act}
SESSIONS = {"stay": stay, "stills": stay}
