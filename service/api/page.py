"""/ and /web: the browser page, from files of this installation alone."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final

from fastapi import FastAPI, Request
from starlette.responses import Response

from service.api.ranges import matches
from service.errors import NotFoundError

#: a script of somebody else, a style in an attribute, a frame around the page: the browser itself refuses them
POLICY: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob: data:",
        "media-src 'self' blob:",
        "connect-src 'self'",
        "form-action 'none'",
        "frame-ancestors 'none'",
        "base-uri 'none'",
    )
)
_HEADERS: Final = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    # modules of two versions must not meet: each use asks whether the file is still the same
    "Cache-Control": "no-cache",
}
_MEDIA_TYPES: Final = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
_INDEX: Final = "index.html"


@dataclass(frozen=True)
class _File:
    content: bytes
    etag: str
    media_type: str


def install(app: FastAPI) -> None:
    """Add the page and its files, which are read once. They hold no data, so they ask for no key."""
    known = _read(files("service") / "web")

    @app.api_route("/", methods=["GET", "HEAD"], include_in_schema=False)
    def page(request: Request) -> Response:
        return _answer(request, known[_INDEX])

    @app.api_route("/web/{name:path}", methods=["GET", "HEAD"], include_in_schema=False)
    def asset(name: str, request: Request) -> Response:
        if name not in known or name == _INDEX:
            raise NotFoundError(f"there is no file {name}")
        return _answer(request, known[name])


def _read(folder: Traversable, prefix: str = "") -> dict[str, _File]:
    """The files of the page by their paths; what is no part of a page is left out."""
    found: dict[str, _File] = {}
    for entry in folder.iterdir():
        if entry.is_dir():
            found |= _read(entry, f"{prefix}{entry.name}/")
            continue
        media_type = _MEDIA_TYPES.get(entry.name.rpartition(".")[2])
        if media_type is not None:
            content = entry.read_bytes()
            found[prefix + entry.name] = _File(content, f'"{hashlib.sha256(content).hexdigest()}"', media_type)
    return found


def _answer(request: Request, file: _File) -> Response:
    headers = {**_HEADERS, "ETag": file.etag}
    if matches(request.headers.get("if-none-match"), file.etag):
        return Response(status_code=304, headers=headers)
    # Starlette counts the bytes before a HEAD's are left out
    return Response(file.content, headers=headers, media_type=file.media_type)
