"""Early answers that arrive: the rest of a refused request is read for a moment before the answer goes out.

A server that answers and closes while the client still sends makes the kernel reset the connection, and the reset
can overtake the answer (RFC 9112, 9.6). A body that says it is nearly over is therefore read to its end, and one
that says nothing a little further, both for a bounded time; a client with much more to send is cut off. So is one
whose body is too large by more than a little: of such a body less than 1 MiB over its limit is read.
"""

from __future__ import annotations

import asyncio
import time
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

DECLARED_BYTES: Final = 4 * 1024 * 1024
UNDECLARED_BYTES: Final = 256 * 1024
#: over the limit of a body that is refused as too large: a message is up to 320 KiB, and one more may be on its way
OVER_BYTES: Final = 384 * 1024
DRAIN_S: Final = 2.0
_FIRST_ERROR: Final = 400
_TOO_LARGE: Final = 413


def note_limit(request: Request, limit_bytes: int) -> None:
    """Say how large the body of this request may be, before any of it is read."""
    request.state.body_limit = limit_bytes


class DrainBeforeRefusal:
    """ASGI middleware: before an error is answered, read what the client is still sending, within limits."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        # a client that waits for "100 Continue" has sent no body, and must not be invited to
        if scope["type"] != "http" or "expect" in Headers(scope=scope):
            await self._app(scope, receive, send)
            return
        body = _Body(receive, Headers(scope=scope).get("content-length", ""))

        async def drained(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] >= _FIRST_ERROR:
                limit = scope["state"].get("body_limit") if message["status"] == _TOO_LARGE else None
                await body.drain(None if limit is None else limit + OVER_BYTES)
                if body.more:  # no other request can follow on this connection
                    MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self._app(scope, body.receive, drained)


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
