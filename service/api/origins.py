"""Whom a request is for and which page sent it: a web page of another site must neither read nor write here.

A page can have its own name resolve to this machine and then read what it likes (DNS rebinding); the Host of its
requests is still its own name. It can also post a form to any address (cross-site request forgery); its browser then
says so in Origin and Sec-Fetch-Site, which no page can change (Fetch Standard, 3.2; W3C Fetch Metadata). Clients that
are no browsers send neither and are not held up. Reads are for the browser to guard; a route that writes when it is
read depends on `write_of_own_site`.
"""

from __future__ import annotations

from typing import Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.problems import problem_response
from service.errors import ForbiddenError, MisdirectedError, ServiceError

#: methods that ask for no change (RFC 9110, 9.2.1)
_SAFE: Final = frozenset({"GET", "HEAD", "OPTIONS", "TRACE"})
_FIRST_ERROR: Final = 400
_DEFAULT_PORTS: Final = {"http": 80, "https": 443}


class Cors(CORSMiddleware):
    """Starlette's, with a problem for an answer where a preflight is refused."""

    def preflight_response(self, request_headers: Headers) -> Response:
        """The answer to a preflight."""
        answer = super().preflight_response(request_headers)
        return answer if answer.status_code < _FIRST_ERROR else _RefusedPreflight(answer)


class _RefusedPreflight(Response):
    def __init__(self, refused: Response) -> None:
        super().__init__()
        self._reason = bytes(refused.body).decode()
        self._kept = {name: value for name, value in refused.headers.items() if not name.startswith("content-")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        hint = "; PVG_ALLOWED_ORIGINS names those whose pages may call this service" if "origin" in self._reason else ""
        error = ForbiddenError(f"{self._reason}{hint}", headers=self._kept)
        await problem_response(Request(scope), error)(scope, receive, send)


class OwnHostAndOrigin:
    """ASGI middleware: refuses requests for another host (421, RFC 9110, 15.5.20) and writes of other sites (403).

    ``hosts`` are names without ports, None for any; ``origins`` are those of other sites whose pages may write.
    """

    def __init__(self, app: ASGIApp, *, hosts: frozenset[str] | None, origins: frozenset[str]) -> None:
        self._app = app
        self._hosts = hosts
        self._origins = origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        may_write = self._may_write(headers)
        scope.setdefault("state", {})["may_write"] = may_write
        is_safe = scope["method"] in _SAFE and not _is_preflight(scope["method"], headers)
        refusal = self._refusal(headers, may_write=may_write or is_safe)
        if refusal is None:
            await self._app(scope, receive, send)
        else:
            await problem_response(Request(scope), refusal)(scope, receive, send)

    def _refusal(self, headers: Headers, *, may_write: bool) -> ServiceError | None:
        if self._hosts is not None and host_name(headers.get("host", "")) not in self._hosts:
            return MisdirectedError("this service does not answer to that Host; PVG_ALLOWED_HOSTS names more")
        return None if may_write else _of_another_site()

    def _may_write(self, headers: Headers) -> bool:
        origin = headers.get("origin")
        if origin is not None and origin.lower() in self._origins:
            return True
        # what the browser itself says of the page; "none" is a user's own doing
        site = headers.get("sec-fetch-site")
        if site is not None:
            return site in {"same-origin", "none"}
        return origin is None or _is_own(origin, headers.get("host", ""))


def _is_preflight(method: str, headers: Headers) -> bool:
    """A browser asks whether a page may send what it wants to (Fetch Standard, 3.3.2); `Cors`, if there, answers."""
    return method == "OPTIONS" and "access-control-request-method" in headers


def _of_another_site() -> ForbiddenError:
    return ForbiddenError("a page of another site may not write here; PVG_ALLOWED_ORIGINS names those that may")


async def write_of_own_site(request: Request) -> None:
    """What a route depends on that writes though its method asks for no change. Raises `ForbiddenError`."""
    if not request.state.may_write:
        raise _of_another_site()


def host_name(host: str) -> str | None:
    """The name in a Host header (RFC 9110, 7.2), in lower case, without port and brackets; None if it is malformed."""
    try:
        parts = urlsplit(f"//{host}")
        parts.port  # noqa: B018 - raises for what is no port
    except ValueError:
        return None
    if parts.path or parts.query or parts.fragment or "@" in host or any(one.isspace() for one in host):
        return None
    return (parts.hostname or "").removesuffix(".") or None


def _is_own(origin: str, host: str) -> bool:
    """True when a page's origin is the host it writes to. TLS may end at a proxy, so either scheme will do."""
    try:
        page = urlsplit(origin)
        own = urlsplit(f"//{host}")
        default = _DEFAULT_PORTS.get(page.scheme)
        return (
            default is not None
            and page.hostname is not None
            and page.hostname == own.hostname
            and (page.port or default) == (own.port or default)
        )
    except ValueError:
        return False
