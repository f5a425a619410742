"""The process of one job: it confines itself, makes one call or is asked for a while, answers, and ends."""

from __future__ import annotations

import errno
import os
import signal
import socket
import threading
import time
import traceback
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

from worker.sandbox.channel import Receiver, send
from worker.sandbox.confinement import Limits, View, confine
from worker.sandbox.faults import fault_of, with_causes

_PROGRESS_S = 0.1  # between two reports of one stage
_SHOWN_CHARACTERS = 4000


def run(descriptor: int, calls: ModuleType, *, parent: int, lacking: Collection[str]) -> NoReturn:
    """Do the one job that is asked for at the other end of the socket ``descriptor``; never returns.

    ``calls`` has CALLS and SESSIONS, functions by name, and `begin`; of a session the function answers with another,
    which is asked until the supervisor has enough. ``lacking`` is what this machine cannot confine, and all that may be
    missing. Nothing but the answer leaves this process.
    """
    code = 1
    try:
        _close_all_but(descriptor)
        with socket.socket(fileno=descriptor) as channel:
            try:
                receiver = Receiver(channel)
                (request,) = _first(receiver)
                limits = Limits(**request["limits"])
                view = View(tuple(Path(path) for path in request["read"]), Path(request["folder"]))
                if further := set(confine(limits, view, parent=parent)) - set(lacking):
                    raise OSError(f"this job is not confined: {', '.join(sorted(further))}")
                calls.begin()
                if request["stays"]:
                    _stay(channel, receiver, calls.SESSIONS[request["call"]](request["arguments"]))
                answer = {"result": calls.CALLS[request["call"]](request["arguments"], _progress_to(channel))}
            except BaseException as error:
                answer = {"error": _described(error)}
            send(channel, answer)
        code = 0
    finally:
        os._exit(code)  # threads of the libraries may never end


def _close_all_but(descriptor: int) -> None:
    """Keep the channel alone, and read and write nowhere by the usual three."""
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGCHLD, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN if number == signal.SIGPIPE else signal.SIG_DFL)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for usual in range(3):
        os.dup2(nowhere, usual)
    for other in [int(name) for name in os.listdir("/dev/fd")]:
        if other > 2 and other != descriptor:
            with suppress(OSError):  # that of the list itself
                os.close(other)


def _first(receiver: Receiver) -> list[dict[str, Any]]:
    while not receiver.ended:
        if found := receiver.read():
            return found
    os._exit(1)  # the supervisor is gone


def _stay(channel: socket.socket, receiver: Receiver, answer_to: Callable[[Any], dict[str, Any]]) -> NoReturn:
    """Answer one question after the other about what was opened, until the supervisor closes its end."""
    send(channel, {"result": {}})
    while True:
        for question in _first(receiver):
            try:
                answer = {"result": answer_to(question["arguments"])}
            except Exception as error:
                answer = {"error": _described(error)}
            send(channel, answer)


def _progress_to(channel: socket.socket) -> Callable[[str, int, int], None]:
    lock = threading.Lock()
    last = ("", 0.0)

    def progress(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        with lock:
            if stage == last[0] and now - last[1] < _PROGRESS_S and done < total:
                return
            last = (stage, now)
            send(channel, {"progress": [stage, done, total]})

    return progress


def _described(error: BaseException) -> dict[str, Any]:
    """What the supervisor is told. Which limit was met is only seen here, where the libraries say so."""
    links = with_causes(error)
    numbers = {getattr(link, "errno", None) for link in links}
    shown = "".join(traceback.format_exception(error))
    return {
        "class": type(error).__name__,
        "message": str(error)[:_SHOWN_CHARACTERS],
        "trace": shown[-_SHOWN_CHARACTERS:],
        "out_of_memory": errno.ENOMEM in numbers or any(map(_is_out_of_memory, links)),
        "file_too_long": errno.EFBIG in numbers,
        "no_room": not numbers.isdisjoint({errno.ENOSPC, errno.EDQUOT}),
        "fault": fault_of(error),
        "limit": _limit_of(error),
    }


def _limit_of(error: BaseException) -> list[Any] | None:
    """What the input may have of what it has too much of, if the method says so: a number and its unit."""
    limit, unit = getattr(error, "limit", None), getattr(error, "unit", None)
    return [limit, unit] if isinstance(limit, int | float) and isinstance(unit, str) else None


def _is_out_of_memory(error: BaseException) -> bool:
    if isinstance(error, MemoryError):
        return True
    words = str(error)
    return any(word in words for word in ("Insufficient memory", "bad_alloc", "bad allocation", "out of memory"))
