"""What one connection may take: time, header lines, a place among the others. What is over the limits is cut off.

uvicorn reads HTTP/1.1 and runs the application; it waits for ever for a request that does not come, answers what it
cannot read in plain text, and knows no limit on header lines or on a body's speed. `BoundedProtocol` adds these. Where
an answer can still be given it is a problem (RFC 9457) with ``Connection: close``.
"""

from __future__ import annotations

import asyncio
import json
import logging
import re
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from http import HTTPStatus
from typing import Any, Final, cast

import h11
import structlog
import uvicorn
from starlette.types import Scope
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.api.draining import note_stop
from service.api.places import has_place
from service.api.request_ids import request_id_of
from service.api.targets import in_origin_form
from service.errors import PROBLEM_JSON, PROBLEMS, ProblemType, problem_body, type_of
from service.ids import new_id
from service.settings import Settings

log = structlog.get_logger(__name__)

#: lines and bytes of a request's head
MAX_HEAD_LINES: Final = 100
MAX_HEAD_BYTES: Final = 16 * 1024
#: how long a refused client may take to read the answer and to stop sending (RFC 9112, 9.6)
LINGER_S: Final = 2.0
#: between two looks at a connection
TICK_S: Final = 1.0
LOG_EVERY_S: Final = 10.0
#: who takes nothing of an answer for so long does not read it: a full buffer alone is what slow clients always have
UNREAD_S: Final = 5.0
#: chunks of a body, after which they have so many bytes on average: each costs as much as a kilobyte does
FREE_CHUNKS: Final = 1000
MIN_CHUNK_BYTES: Final = 64
_END_OF_HEAD: Final = re.compile(rb"\n\r?\n")
#: of a request's state: what came of its body, and was not read, before its connection was lost
_UNREAD: Final = "unread"

# what uvicorn warns of is what any client can send; that is counted here
_errors_only = logging.getLogger("uvicorn.error.connections")
_errors_only.setLevel(logging.ERROR)


@dataclass(frozen=True)
class Limits:
    """Of one connection, but for their number."""

    connections: int
    idle_s: float
    head_s: float
    body_s: float
    min_body_bytes_per_s: float
    send_s: float
    #: what the addresses in problems begin with
    root_path: str = ""

    @classmethod
    def of(cls, settings: Settings) -> Limits:
        """Those of the settings."""
        return cls(
            connections=settings.max_connections,
            idle_s=settings.idle_timeout_s,
            head_s=settings.head_timeout_s,
            body_s=settings.body_timeout_s,
            min_body_bytes_per_s=settings.min_body_bytes_per_s,
            send_s=settings.send_timeout_s,
            root_path=settings.root_path,
        )


class Tally:
    """Counts what happens often under attack, and logs the counts now and then: the log must not fill the disk."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._last = float("-inf")

    def count(self, what: str) -> None:
        """Note one event."""
        self._counts[what] = self._counts.get(what, 0) + 1
        if time.monotonic() - self._last >= LOG_EVERY_S:
            log.info("connections cut off", **self._counts)
            self._counts.clear()
            self._last = time.monotonic()


class BoundedConfig(uvicorn.Config):
    """uvicorn's configuration with limits for its connections."""

    def __init__(self, app: Any, limits: Limits, **options: Any) -> None:
        super().__init__(app, http=BoundedProtocol, ws="none", **options)
        self.limits = limits
        self.tally = Tally()


class Phase(Enum):
    """What a connection is waiting for."""

    IDLE = auto()  # the first byte of a request
    HEAD = auto()  # the rest of a request's head
    BODY = auto()  # more of a body that the application wants
    WORK = auto()  # the application
    SEND = auto()  # the client, to take more of the answer
    CLOSE = auto()  # the client, to take the rest of the last answer
    REFUSED = auto()  # the client, to read why


class _TinyChunksError(h11.RemoteProtocolError):
    """The chunks of a body are too many for its bytes."""


class _Parser(h11.Connection):
    """h11's parser, which refuses more: heads of many lines, and framing that two readers could understand differently.

    The latter is how one request is smuggled inside another: a request with both lengths is answered by closing the
    connection, and so is a transfer coding in HTTP/1.0 (RFC 9112, 6.1). And bodies of thousands of tiny chunks.
    """

    _chunks = _chunk_bytes = 0

    def next_event(self) -> h11.Event | type[h11.NEED_DATA] | type[h11.PAUSED]:
        """The next event. Raises `h11.RemoteProtocolError`."""
        if self.their_state is h11.IDLE:
            received, _ = self.trailing_data
            end = _END_OF_HEAD.search(received)
            head = received[: end.start()] if end else received
            if len(head) > MAX_HEAD_BYTES or head.count(b"\n") > MAX_HEAD_LINES:
                raise h11.RemoteProtocolError("the head is too large", error_status_hint=431)
        event = super().next_event()
        if isinstance(event, h11.Data):
            self._count(event)
        elif isinstance(event, h11.Request):
            self._chunks = self._chunk_bytes = 0
            names = [name for name, _ in event.headers]
            if b"transfer-encoding" in names and (b"content-length" in names or event.http_version < b"1.1"):
                raise h11.RemoteProtocolError("the length of the body is ambiguous")
            event = in_origin_form(event)
        return event

    def _count(self, data: h11.Data) -> None:
        self._chunks += data.chunk_start
        self._chunk_bytes += len(data.data)
        # the last one may not have come whole
        if self._chunks > FREE_CHUNKS and self._chunk_bytes < MIN_CHUNK_BYTES * (self._chunks - 1):
            raise _TinyChunksError(f"the chunks of the body have fewer than {MIN_CHUNK_BYTES} bytes on average")


class BoundedProtocol(H11Protocol):
    """uvicorn's protocol of one connection, with limits. Its configuration must be a `BoundedConfig`."""

    def __init__(self, config: BoundedConfig, *arguments: Any, **options: Any) -> None:
        super().__init__(config, *arguments, **options)
        self._limits = config.limits
        self._tally = config.tally
        self.conn = _Parser(h11.SERVER, MAX_HEAD_BYTES)
        self.logger = _errors_only
        self._phase = Phase.IDLE
        self._since = self.loop.time()
        self._body_bytes = 0
        self._refused = False
        self._watch: asyncio.TimerHandle | None = None

    # what asyncio calls

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's own
        """Find a place for the connection, or refuse it."""
        super().connection_made(transport)
        self._watch = self.loop.call_later(TICK_S, self._tick)
        # to close one that was refused makes no room: it had no place
        while len(self.connections) > self._limits.connections:
            if not self._make_room():
                self.refuse(PROBLEMS["unavailable"], "there are too many connections; try again", Retry_After="5")
                return

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        if self._watch is not None:
            self._watch.cancel()
        if self.cycle is not None and not self.cycle.response_complete:
            # the application is told that the client has gone, and of nothing that it has not read by then
            self.cycle.scope["state"][_UNREAD] = bytes(self.cycle.body)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes in, but for those that follow a refusal."""
        if not self._refused:
            self._body_bytes += len(data)
            super().data_received(data)

    def eof_received(self) -> None:
        """The client sends no more: after a refusal that is all there was to wait for."""
        if self._refused:
            self.transport.close()

    def resume_writing(self) -> None:
        """The client has taken a good part of what was waiting."""
        super().resume_writing()
        self._since = self.loop.time()

    # what uvicorn calls

    def on_response_complete(self) -> None:
        """The next request may come."""
        self._enter(Phase.IDLE)
        super().on_response_complete()

    def send_400_response(self, msg: str) -> None:
        """Answer what the parser refused: it is called while its error is handled, and that error knows the status."""
        error = sys.exception()
        status = error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else 400
        kind = {431: PROBLEMS["header-too-large"], 501: PROBLEMS["not-implemented"]}.get(status, PROBLEMS["malformed"])
        details = {
            431: f"the head of a request has at most {MAX_HEAD_LINES} lines and {MAX_HEAD_BYTES} bytes",
            501: "the only transfer coding is chunked",
        }
        detail = details.get(status, "this is not HTTP/1.1 as RFC 9112 has it")
        self.refuse(kind, str(error) if isinstance(error, _TinyChunksError) else detail)

    def shutdown(self) -> None:
        """The server stops."""
        if self._refused:
            self.transport.close()
        else:
            super().shutdown()

    def end_body(self) -> None:
        """The server has to stop soon: the application, if more of a body is to come, is told that none does."""
        cycle = self.cycle
        if not self._refused and cycle is not None and cycle.more_body and not cycle.response_started:
            note_stop(cycle.scope["state"])
            cycle.message_event.set()

    # the limits

    @property
    def waits(self) -> bool:
        """True when closing the connection harms no request that has come whole."""
        return self._now_in() in {Phase.IDLE, Phase.HEAD, Phase.REFUSED}

    @property
    def is_unread(self) -> bool:
        """True when a client who has no key, or link of one, has taken nothing of an answer for some seconds."""
        # `_since` is of the phase at the last look: one that has just begun has no time yet
        if self._phase not in {Phase.SEND, Phase.CLOSE} or self.loop.time() - self._since < UNREAD_S:
            return False
        cycle = self.cycle
        state = cycle.scope.get("state", {}) if cycle is not None else {}
        return self._now_in() in {Phase.SEND, Phase.CLOSE} and not has_place(state)

    def _make_room(self) -> bool:
        """Close the connection that has kept us waiting longest for a request. False when all of them work.

        Unread answers to nobody are no work where they have more than half of the connections: keys have the others.
        """
        others = [one for one in self.connections if isinstance(one, BoundedProtocol) and one is not self]
        idle = [one for one in others if one.waits]
        if not idle:
            idle = [one for one in others if one.is_unread]
            if len(idle) <= self._limits.connections // 2:
                return False
        longest = min(idle, key=lambda one: one._since)
        self._tally.count("evicted")
        self.connections.discard(longest)
        longest.transport.abort()
        return True

    def _now_in(self) -> Phase:
        cycle = self.cycle
        if self._refused:
            return Phase.REFUSED
        if self.transport.is_closing():
            return Phase.CLOSE
        if cycle is None or cycle.response_complete:
            return Phase.IDLE if self.conn.their_state is h11.IDLE and not self.conn.trailing_data[0] else Phase.HEAD
        if self.flow.write_paused:
            return Phase.SEND
        if cycle.more_body and not cycle.waiting_for_100_continue and not self.flow.read_paused:
            return Phase.BODY
        return Phase.WORK

    def _enter(self, phase: Phase) -> None:
        self._phase, self._since, self._body_bytes = phase, self.loop.time(), 0

    def _tick(self) -> None:
        self._watch = self.loop.call_later(TICK_S, self._tick)
        phase = self._now_in()
        if phase is not self._phase:
            self._enter(phase)
        limits = self._limits
        allowed = {
            Phase.IDLE: limits.idle_s,
            Phase.HEAD: limits.head_s,
            Phase.BODY: limits.body_s,
            Phase.SEND: limits.send_s,
            Phase.CLOSE: limits.send_s,
            Phase.REFUSED: LINGER_S,
        }.get(phase)
        if allowed is None or self.loop.time() - self._since < allowed:
            return
        match phase:
            case Phase.IDLE:
                self._tally.count("silent")
                self.transport.close()
            case Phase.HEAD:
                self.refuse(PROBLEMS["too-slow"], f"the head of the request took longer than {limits.head_s:g} s")
            case Phase.BODY if self._body_bytes < limits.min_body_bytes_per_s * allowed:
                few = f"fewer than {limits.min_body_bytes_per_s:g} bytes a second came for {limits.body_s:g} s"
                self.refuse(PROBLEMS["too-slow"], few)
            case Phase.BODY:
                self._enter(phase)
            case _:
                if phase is not Phase.REFUSED:  # those were counted when they were
                    self._tally.count("unread")
                self.transport.abort()

    def refuse(self, kind: ProblemType, detail: str, **headers: str) -> None:
        """Answer with a problem in place of the application, if it has not begun to, and take leave of the client."""
        self._tally.count(kind.type.replace("-", "_"))
        self._refused = True
        self._unset_keepalive_if_required()
        cycle = self.cycle
        begun = False
        if cycle is not None and not cycle.response_complete:
            begun = cycle.response_started
            # the application learns that there is nobody left to answer
            cycle.disconnected = True
            cycle.message_event.set()
        if begun or self.transport.is_closing():
            self.transport.abort()
            return
        self._enter(Phase.REFUSED)
        problem = problem_body(kind, detail) | {"type": type_of(kind.type, self._limits.root_path)}
        whose: dict[str, Any] = {"instance": "", "request_id": new_id("req")}
        if cycle is not None and not cycle.response_complete:
            # the application may not have begun: a body's first bytes may come with its head
            whose = {"instance": self.scope["path"], "request_id": request_id_of(cast("Scope", self.scope))}
        self.transport.write(_answer(problem | whose, self.server_state.default_headers, headers))
        self.flow.resume_reading()
        # what the client still sends is read and dropped: closing now could make the kernel throw the answer away
        try:
            self.transport.write_eof()
        except OSError:  # the client has gone already
            self.transport.abort()


def unread(state: Mapping[str, Any]) -> bytes:
    """What came of a body and was not read before the connection was lost; ``state`` is that of the request."""
    rest: bytes = state.get(_UNREAD, b"")
    return rest


def _answer(problem: dict[str, Any], default_headers: list[tuple[bytes, bytes]], headers: dict[str, str]) -> bytes:
    body = json.dumps(problem).encode()
    lines = {
        **{name.decode("latin-1"): value.decode("latin-1") for name, value in default_headers},
        "Content-Type": PROBLEM_JSON,
        "Content-Length": str(len(body)),
        "Connection": "close",
        "X-Content-Type-Options": "nosniff",
        "X-Request-ID": problem["request_id"],
        **{name.replace("_", "-"): value for name, value in headers.items()},
    }
    head = f"HTTP/1.1 {problem['status']} {HTTPStatus(problem['status']).phrase}\r\n"
    return (head + "".join(f"{name}: {value}\r\n" for name, value in lines.items()) + "\r\n").encode("latin-1") + body
