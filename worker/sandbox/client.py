"""The supervisor's side: one call, or a session of several, in a process of its own."""

from __future__ import annotations

import select
import signal
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from typing import Any, Final

import structlog

from worker.sandbox.channel import ProtocolError, Receiver, send
from worker.sandbox.confinement import Limits, View
from worker.sandbox.faults import Fault

log = structlog.get_logger(__name__)

#: between two looks at whether the job is to go on
POLL_S: Final = 0.2
#: of the memory limit: a process that a signal ended above it has most likely met the limit inside a library
_NEARLY: Final = 0.9
#: of limits of the input, see `pvg.errors.LimitError`
_UNITS: Final = frozenset({"seconds", "frames", "pixels", "frames per second", "streams", "bytes", "bytes of memory"})
#: a number that JSON and its readers have exactly
_MOST: Final = 2**53
#: for the kernel to end a process that holds some GB
_END_S: Final = 10.0


class MethodError(Exception):
    """The call raised: the name of the error's class and its message, as the job's process tells them.

    ``limit`` is the most that is accepted of what the input is over, and its unit. ``fault``: it is, or may be, that
    of a disk or a shared folder.
    """

    def __init__(
        self,
        kind: str,
        message: str,
        trace: str = "",
        limit: tuple[float, str] | None = None,
        fault: Fault | None = None,
    ) -> None:
        super().__init__(message)
        self.kind = kind
        self.trace = trace
        self.limit = limit
        self.fault = fault

    def saying(self, message: str) -> MethodError:
        """The same error in other words."""
        return MethodError(self.kind, message, self.trace, self.limit, self.fault)


class LimitError(Exception):
    """The job has met a limit of what one job may take: ``limit``, where it is a number, and its unit."""

    def __init__(self, message: str, limit: tuple[float, str] | None = None) -> None:
        super().__init__(message)
        self.limit = limit


class MemoryLimitError(LimitError):
    """It needed more memory."""


class FileLimitError(LimitError):
    """It wrote a longer file."""


class TimeLimitError(LimitError):
    """It took longer, by the clock or in processor time."""


class NoRoomError(Exception):
    """The disk was full while the job wrote."""


class CrashError(Exception):
    """The job's process ended without an answer, or with one that it cannot have given by itself."""


class UnforkedError(CrashError):
    """The process that jobs are forked from could not fork, or is gone."""


@dataclass(frozen=True)
class Watch:
    """How a call is watched.

    check: raises when the work has to stop; called every `POLL_S`.  progress: called with stage, done, total, and may
    raise too.  until: on the clock of `time.monotonic`.
    """

    check: Callable[[], None]
    progress: Callable[[str, int, int], None]
    until: float


class Sandbox:
    """Asks the fork server for processes. Any number of supervisors may share its ``lobby``."""

    def __init__(self, lobby: socket.socket) -> None:
        self._lobby = lobby

    def call(self, name: str, arguments: Mapping[str, Any], *, limits: Limits, view: View, watch: Watch) -> Any:
        """The answer of the call, not checked yet, once its process is gone and can change nothing any more.

        Raises `MethodError`, a `LimitError`, `NoRoomError`, `CrashError`, and what ``watch`` raises; the process has
        ended then too.
        """
        with ExitStack() as stack:
            process = self._process(stack, name, arguments, limits, view, stays=False)
            return _Waiting(process, limits, watch).result()

    def open(self, name: str, arguments: Mapping[str, Any], *, limits: Limits, view: View, until: float) -> Session:
        """A process that stays and is asked again and again about what it has opened, once it has.

        ``until``: on the clock of `time.monotonic`. Raises as `call` does; the process has ended then too.
        """
        with ExitStack() as stack:
            process = self._process(stack, name, arguments, limits, view, stays=True)
            session = Session(process, limits, stack.pop_all())
        try:
            session.answer(until)
        except BaseException:
            session.close()
            raise
        return session

    def _process(
        self, stack: ExitStack, name: str, arguments: Mapping[str, Any], limits: Limits, view: View, *, stays: bool
    ) -> _Process:
        """A new process, which is told what to do, and ended with the stack."""
        request = {
            "call": name,
            "stays": stays,
            "arguments": arguments,
            "limits": asdict(limits),
            "read": [str(path) for path in view.read],
            "folder": str(view.folder),
        }
        (control, their_control), (channel, their_channel) = socket.socketpair(), socket.socketpair()
        stack.enter_context(control)
        stack.enter_context(channel)
        with their_control, their_channel:
            socket.send_fds(self._lobby, [b"j"], [their_control.fileno(), their_channel.fileno()])
        stack.callback(_make_sure, control)
        process = _Process(control, channel)
        process.tell(request)
        return process


class _Process:
    """A process by the supervisor's ends of it: by closing ``control`` it is ended, by ``channel`` it is talked to.

    Once it `has_ended`, ``end`` is what the server tells of that: None where that is gone too, or could not fork.
    """

    def __init__(self, control: socket.socket, channel: socket.socket) -> None:
        self._control, self._channel = control, channel
        self._ends, self._answers = Receiver(control), Receiver(channel)
        self._poll = select.poll()
        self._poll.register(control, select.POLLIN)
        self._poll.register(channel, select.POLLIN)
        self.end: dict[str, Any] | None = None

    @property
    def has_ended(self) -> bool:
        """Whether it is gone, or never was."""
        return self._ends.ended or self.end is not None

    def tell(self, message: dict[str, Any]) -> None:
        """Send it a message. That it has ended, or was never forked, is told by its end."""
        with suppress(OSError):
            send(self._channel, message)

    def hear(self, seconds: float) -> list[dict[str, Any]] | None:
        """What it has said, at most so many seconds later; nothing where it has ended; None when the time is over.

        Raises `CrashError` for what is no message.
        """
        ready = {descriptor for descriptor, _ in self._poll.poll(seconds * 1000)}
        if not ready:
            return None
        messages: list[dict[str, Any]] = []
        if self._channel.fileno() in ready:
            messages = self._read()
            if self._answers.ended:
                self._poll.unregister(self._channel)
        if not messages and self._control.fileno() in ready:  # else the end is heard next, it stays there
            self.end = next(iter(self._ends.read()), None)
        return messages

    def rest(self) -> Iterator[dict[str, Any]]:
        """What it had said before it ended, and nobody has heard: all of it is there by now."""
        while not self._answers.ended:
            yield from self._read()

    def _read(self) -> list[dict[str, Any]]:
        try:
            return self._answers.read()
        except ProtocolError as error:
            raise CrashError(f"its process sent {error}") from error


class Session:
    """A process that stays, for one thread at a time. After any error but `MethodError` it is gone, or as good as."""

    def __init__(self, process: _Process, limits: Limits, held: ExitStack) -> None:
        self._process, self._limits = process, limits
        self._held = held

    def ask(self, arguments: Mapping[str, Any], until: float) -> Any:
        """The answer to a question, not checked yet; ``until`` is on the clock of `time.monotonic`.

        Raises as `Sandbox.call` does.
        """
        self._process.tell({"arguments": arguments})
        return self.answer(until)

    def answer(self, until: float) -> Any:
        """Wait for one answer."""
        while True:
            messages = self._process.hear(max(0.0, until - time.monotonic()))
            if messages is None:
                raise TimeLimitError("the picture took longer than the service allows")
            if len(messages) > 1:
                raise CrashError("its process sent two answers in one")
            if messages:
                return answer_of(messages[0], self._limits)
            if self._process.has_ended:
                judge_end(self._process.end, self._limits)
                raise CrashError("its process ended by itself")

    def close(self) -> None:
        """End the process, and wait for that."""
        self._held.close()


def _make_sure(control: socket.socket) -> None:
    """Have the process ended, and wait for that: it must not write into files that are taken away."""
    try:
        control.shutdown(socket.SHUT_WR)
        control.settimeout(_END_S)
        while control.recv(4096):
            pass
    except TimeoutError:
        log.warning("a job's process is killed and does not end", seconds=_END_S)
    except OSError:
        pass  # it had ended, or the server is gone, and the process with it


def _is_progress(stage: str, done: int, total: int) -> bool:
    """Whether the records can take it."""
    return (
        stage.isascii()
        and stage.isprintable()
        and len(stage) < 40
        and 0 <= min(done, total) <= max(done, total) < 2**31
    )


class _Waiting:
    """One call on its way."""

    def __init__(self, process: _Process, limits: Limits, watch: Watch) -> None:
        self._process, self._limits, self._watch = process, limits, watch
        self._answer: dict[str, Any] | None = None

    def result(self) -> Any:
        while not self._process.has_ended:
            messages = self._process.hear(POLL_S)
            self._watch.check()
            if time.monotonic() > self._watch.until:
                raise TimeLimitError("the job took longer than the service allows")
            for message in messages or ():
                self._take(message)
        for message in self._process.rest():
            self._take(message)
        return self._judged()

    def _take(self, message: dict[str, Any]) -> None:
        if self._answer is not None:
            raise CrashError("its process went on after its answer")
        match message:
            case {"progress": [str(stage), int(done), int(total)], **rest} if not rest and _is_progress(
                stage, done, total
            ):
                self._watch.progress(stage, done, total)
            case {"result": dict()} | {"error": {"class": str(), "message": str(), "trace": str()}}:
                if len(message) != 1:
                    raise CrashError("its process sent two answers in one")
                self._answer = message
            case _:
                raise CrashError("its process sent something else than an answer")

    def _judged(self) -> Any:
        judge_end(self._process.end, self._limits)
        if self._answer is None:
            raise CrashError("its process ended with code 0")
        return answer_of(self._answer, self._limits)


def judge_end(end: dict[str, Any] | None, limits: Limits) -> None:
    """Raise what the end of a process means, as the server tells it: None where that is gone too, or could not fork."""
    if end is None:
        raise UnforkedError("the process that jobs are forked from is gone, or could not fork")
    number, code = int(end["signal"]), int(end["code"])
    if number == signal.SIGXCPU or (number and end["cpu_s"] >= limits.cpu_s):
        raise TimeLimitError("the job took more processor time than the service allows")
    if number and end["max_rss_bytes"] > _NEARLY * limits.memory_bytes:
        raise _out_of_memory(limits)
    if number or code:
        raise CrashError(f"its process ended with {f'signal {number}' if number else f'code {code}'}")


def answer_of(message: dict[str, Any], limits: Limits) -> Any:
    """The result of an answer. Raises the error that it tells of, and `CrashError` when it is no answer."""
    match message:
        case {"result": dict(result), **rest} if not rest:
            return result
        case {"error": {"class": str(kind), "message": str(text), "trace": str(trace), **flags}, **rest} if not rest:
            if flags.get("out_of_memory") is True:
                raise _out_of_memory(limits)
            if flags.get("file_too_long") is True:
                gigabytes = limits.file_bytes / 1e9
                raise FileLimitError(
                    f"a file of the job would be longer than {gigabytes:.1f} GB, the limit of the service",
                    (limits.file_bytes, "bytes"),
                )
            if flags.get("no_room") is True:
                raise NoRoomError(text)
            raise MethodError(kind, text, trace, _limit_of(flags.get("limit")), _fault_of(flags.get("fault")))
    raise CrashError("its process sent something else than an answer")


def _limit_of(told: object) -> tuple[float, str] | None:
    """The limit that an error names, if it is one that there is."""
    match told:
        case [int() | float() as limit, str(unit)] if unit in _UNITS and 0 <= limit <= _MOST:
            return limit, unit
    return None


def _fault_of(told: object) -> Fault | None:
    return told if told in ("certain", "possible") else None


def _out_of_memory(limits: Limits) -> MemoryLimitError:
    gigabytes = limits.memory_bytes / 1e9
    return MemoryLimitError(
        f"the job needs more memory than the {gigabytes:.1f} GB that one may take: scale the file down, or raise "
        "PVG_JOB_MEMORY_BYTES",
        (limits.memory_bytes, "bytes of memory"),
    )
