"""What surrounds each request: its id, its log line, and an answer to an error that nothing else handled."""

from __future__ import annotations

import asyncio
import time
from urllib.parse import urlsplit, urlunsplit

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import tracing
from service.api.draining import cut_off
from service.api.meters import Meters
from service.api.places import Places
from service.api.problems import problem_response
from service.api.request_ids import request_id_of
from service.errors import ServiceError

log = structlog.get_logger(__name__)


def relative(location: str, root_path: str) -> str:
    """A Location without scheme and host (RFC 9110, 10.2.2): those of a request are what its sender says they are.

    A prefix that a proxy has removed from the request's path is put before it, if it is not there.
    """
    parts = urlsplit(location)
    # two slashes at the beginning would name a host again
    path = "/" + parts.path.lstrip("/")
    if root_path and not path.startswith(f"{root_path}/"):
        path = root_path + path
    return urlunsplit(("", "", path, parts.query, parts.fragment))


def _only(values: list[str]) -> str | None:
    return values[0] if len(values) == 1 else None


class RequestContext:
    """ASGI middleware around everything else: X-Request-ID and a log line.

    ``root_path`` is the path prefix that a proxy in front has removed.
    """

    def __init__(self, app: ASGIApp, *, meters: Meters, places: Places, root_path: str = "") -> None:
        self._app = app
        self._meters = meters
        self._places = places
        self._root_path = root_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if self._root_path:
            scope["root_path"] = self._root_path
        request_id = request_id_of(scope)
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(request_id=request_id)
        trace = tracing.parse(_only(Headers(scope=scope).getlist("traceparent")))
        tracing.traceparent.set(trace)
        if trace is not None:
            structlog.contextvars.bind_contextvars(trace_id=tracing.trace_id(trace))
        began = time.perf_counter()
        status = 0
        answered: dict[str, str] = {}
        self._meters.begin()

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = request_id
                headers["X-Content-Type-Options"] = "nosniff"
                # lists that a dependency adds to any answer, errors and streams too
                for name, value in scope["state"].get("answer_headers", {}).items():
                    headers[name] = f"{value}, {headers[name]}" if name in headers else value
                if "location" in headers:
                    headers["Location"] = relative(headers["Location"], self._root_path)
                    answered["location"] = urlsplit(headers["Location"]).path  # a query may open what it leads to
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except ClientDisconnect:
            log.info("client went away", method=scope["method"], path=scope["path"])
            return
        finally:
            self._places.leave(scope["state"])
            self._meters.end(scope, status, time.perf_counter() - began)
        log.info(
            "request",
            method=scope["method"],
            path=scope["path"],
            status=status,
            ms=round((time.perf_counter() - began) * 1000, 1),
            **answered,
        )


class AnswerUnhandled:
    """ASGI middleware: a problem for any unhandled error.

    A request that the server cancels, since its time is over when the service stops, is answered as unavailable.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        has_begun = False

        async def noted(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await self._app(scope, receive, noted)
        except ClientDisconnect:
            raise
        except asyncio.CancelledError:
            log.warning("request cut off: the service stops", method=scope["method"], path=scope["path"])
            if has_begun:
                raise
            # its task ends with this answer; uvicorn would give one of its own for the error
            await problem_response(Request(scope), cut_off())(scope, receive, send)
        except Exception:
            log.exception("unhandled error", method=scope["method"], path=scope["path"])
            if has_begun:
                raise  # too late for an answer: the connection has to break
            error = ServiceError("the request failed on our side; the log has it under this request id")
            await problem_response(Request(scope), error)(scope, receive, send)
