"""Early answers that arrive: the rest of a refused request is read for a moment before the answer goes out.

A server that answers and closes while the client still sends makes the kernel reset the connection, and the reset
can overtake the answer (RFC 9112, 9.6). A body that says it is nearly over is therefore read to its end, and one
that says nothing a little further, both for a bounded time; a client with much more to send is cut off. So is one
whose body is too large by more than a little: of such a body less than 1 MiB over its limit is read.

When the server has to stop, a body is over though more of it is to come, and nothing is read of it any more: whoever
keeps what has come has time for that.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import MutableMapping
from typing import Any, Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import StoppingError

DECLARED_BYTES: Final = 4 * 1024 * 1024
UNDECLARED_BYTES: Final = 256 * 1024
#: over the limit of a body that is refused as too large: a message is up to 320 KiB, and one more may be on its way
OVER_BYTES: Final = 384 * 1024
DRAIN_S: Final = 2.0
_FIRST_ERROR: Final = 400
_TOO_LARGE: Final = 413
#: of a request's state: the server stops before its body is whole
_STOPS: Final = "stops"


def note_limit(request: Request, limit_bytes: int) -> None:
    """Say how large the body of this request may be, before any of it is read."""
    request.state.body_limit = limit_bytes


def note_stop(state: MutableMapping[str, Any]) -> None:
    """Say that the server stops before the body of the request of this state is whole."""
    state[_STOPS] = True


def cut_off() -> StoppingError:
    """What a request is answered with that is not done when the server stops."""
    error = StoppingError("the service stops; try again")
    error.headers["Connection"] = "close"
    return error


class DrainBeforeRefusal:
    """ASGI middleware: before an error is answered, read what the client is still sending, within limits."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        state, headers = scope.setdefault("state", {}), Headers(scope=scope)
        body = _Body(receive, headers.get("content-length", ""))

        async def until_stop() -> Message:
            if not state.get(_STOPS):
                message = await body.receive()
                # what has come before is taken first
                if not state.get(_STOPS) or message.get("body") or not body.more:
                    return message
            raise cut_off()

        async def drained(message: Message) -> None:
            if message["type"] == "http.response.start":
                stops = state.pop(_STOPS, False)
                # a client that waits for "100 Continue" has sent no body, and must not be invited to
                if message["status"] >= _FIRST_ERROR and not stops and "expect" not in headers:
                    limit = state.get("body_limit") if message["status"] == _TOO_LARGE else None
                    await body.drain(None if limit is None else limit + OVER_BYTES)
                    if body.more:  # no other request can follow on this connection
                        MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self._app(scope, until_stop, drained)


class _Body:
    """A request's body as far as it has come."""

    def __init__(self, receive: Receive, declared: str) -> None:
        self._receive = receive
        self._declared = int(declared) if declared.isdecimal() else None
        self._read = 0
        self.more = self._declared != 0

    async def receive(self) -> Message:
        """The next message, counted."""
        message = await self._receive()
        self._read += len(message.get("body", b""))
        self.more = message["type"] == "http.request" and bool(message.get("more_body", False))
        return message

    async def drain(self, most: int | None) -> None:
        """Read on to the end, if it is near, and not beyond ``most`` bytes of the body."""
        if self._declared is None:
            end = self._read + UNDECLARED_BYTES
            end = end if most is None else min(end, most)
        elif self._declared - self._read <= DECLARED_BYTES and (most is None or self._declared <= most):
            end = self._declared
        else:
            return
        deadline = time.monotonic() + DRAIN_S
        while self.more and self._read < end:
            try:
                await asyncio.wait_for(self.receive(), timeout=max(0.0, deadline - time.monotonic()))
            except TimeoutError:
                return
