"""The supervisor's side: one call, or a session of several, in a process of its own."""

from __future__ import annotations

import select
import signal
import socket
import time
from collections.abc import Callable, Mapping
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
            control, channel = self._process(stack, name, arguments, limits, view, stays=False)
            return _Waiting(control, channel, limits, watch).result()

    def open(self, name: str, arguments: Mapping[str, Any], *, limits: Limits, view: View, until: float) -> Session:
        """A process that stays and is asked again and again about what it has opened, once it has.

        ``until``: on the clock of `time.monotonic`. Raises as `call` does; the process has ended then too.
        """
        with ExitStack() as stack:
            control, channel = self._process(stack, name, arguments, limits, view, stays=True)
            session = Session(control, channel, limits, stack.pop_all())
        try:
            session.answer(until)
        except BaseException:
            session.close()
            raise
        return session

    def _process(
        self, stack: ExitStack, name: str, arguments: Mapping[str, Any], limits: Limits, view: View, *, stays: bool
    ) -> tuple[socket.socket, socket.socket]:
        """The supervisor's ends of a new process: by closing the first it is ended, by the second it is talked to."""
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
        with suppress(OSError):  # it has ended, or was never forked: that is told by its end
            send(channel, dict(request))
        return control, channel


class Session:
    """A process that stays, for one thread at a time. After any error but `MethodError` it is gone, or as good as."""

    def __init__(self, control: socket.socket, channel: socket.socket, limits: Limits, held: ExitStack) -> None:
        self._control, self._channel, self._limits = control, channel, limits
        self._held = held
        self._answers = Receiver(channel)

    def ask(self, arguments: Mapping[str, Any], until: float) -> Any:
        """The answer to a question, not checked yet; ``until`` is on the clock of `time.monotonic`.

        Raises as `Sandbox.call` does.
        """
        with suppress(OSError):  # it has ended: why is told by its end
            send(self._channel, {"arguments": arguments})
        return self.answer(until)

    def answer(self, until: float) -> Any:
        """Wait for one answer."""
        poll = select.poll()
        poll.register(self._control, select.POLLIN)
        poll.register(self._channel, select.POLLIN)
        while True:
            ready = {descriptor for descriptor, _ in poll.poll(max(0.0, until - time.monotonic()) * 1000)}
            if not ready:
                raise TimeLimitError("the picture took longer than the service allows")
            if self._channel.fileno() in ready:
                messages = self._messages()
                if len(messages) > 1:
                    raise CrashError("its process sent two answers in one")
                if messages:
                    return answer_of(messages[0], self._limits)
                if self._answers.ended:
                    poll.unregister(self._channel)
            if self._control.fileno() in ready:
                ends = Receiver(self._control).read()
                judge_end(ends[0] if ends else None, self._limits)
                raise CrashError("its process ended by itself")

    def _messages(self) -> list[dict[str, Any]]:
        try:
            return self._answers.read()
        except ProtocolError as error:
            raise CrashError(f"its process sent {error}") from error

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

    def __init__(self, control: socket.socket, channel: socket.socket, limits: Limits, watch: Watch) -> None:
        self._control, self._channel = control, channel
        self._limits, self._watch = limits, watch
        self._answers = Receiver(channel)
        self._answer: dict[str, Any] | None = None

    def result(self) -> Any:
        ends = Receiver(self._control)
        poll = select.poll()
        poll.register(self._control, select.POLLIN)
        poll.register(self._channel, select.POLLIN)
        end: list[dict[str, Any]] = []
        while not ends.ended and not end:
            ready = {descriptor for descriptor, _ in poll.poll(POLL_S * 1000)}
            self._watch.check()
            if time.monotonic() > self._watch.until:
                raise TimeLimitError("the job took longer than the service allows")
            if self._channel.fileno() in ready:
                self._listen()
                if self._answers.ended:
                    poll.unregister(self._channel)
            if self._control.fileno() in ready:
                end = ends.read()
        while not self._answers.ended:
            self._listen()  # all that it said is there by now
        return self._judged(end[0] if end else None)

    def _listen(self) -> None:
        try:
            for message in self._answers.read():
                self._take(message)
        except ProtocolError as error:
            raise CrashError(f"its process sent {error}") from error

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

    def _judged(self, end: dict[str, Any] | None) -> Any:
        judge_end(end, self._limits)
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
