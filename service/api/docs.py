"""/docs, /redoc and /openapi.json: the documentation, from files of this installation alone."""

from __future__ import annotations

import re
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Final

from fastapi import FastAPI, Request
from fastapi.openapi.docs import get_redoc_html, get_swagger_ui_html
from starlette.responses import FileResponse, HTMLResponse, JSONResponse

from service.addresses import PREFIX
from service.api.advice import ADVICE
from service.errors import PROBLEMS, PROBLEMS_PAGE, NotFoundError

#: the files of a page and their media types
ASSETS: Final = {
    "swagger-ui-bundle.js": "text/javascript",
    "swagger-ui.css": "text/css",
    "redoc.standalone.js": "text/javascript",
    "favicon.png": "image/png",
}
_CODE: Final = re.compile(r"`([^`]+)`")
_FOLDER: Final = Path(str(files("fastapi_offline"))) / "static"
# the browser itself refuses whatever a page or its scripts would load from elsewhere
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; script-src 'self' 'unsafe-inline'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
}


def install(app: FastAPI) -> None:
    """Add the schema, both pages and their files."""

    @app.api_route("/openapi.json", methods=["GET", "HEAD"], include_in_schema=False)
    @app.api_route(f"{PREFIX}/openapi.json", methods=["GET", "HEAD"], include_in_schema=False)
    def schema(request: Request) -> JSONResponse:
        root, described = _root(request), app.openapi()
        return JSONResponse(described | {"servers": [{"url": root}]} if root else described)

    @app.api_route("/docs", methods=["GET", "HEAD"], include_in_schema=False)
    @app.api_route(f"{PREFIX}/docs", methods=["GET", "HEAD"], include_in_schema=False)
    def swagger(request: Request) -> HTMLResponse:
        root = _root(request)
        page = get_swagger_ui_html(
            openapi_url=f"{root}/openapi.json",
            title=app.title,
            swagger_js_url=f"{root}/docs/assets/swagger-ui-bundle.js",
            swagger_css_url=f"{root}/docs/assets/swagger-ui.css",
            swagger_favicon_url=f"{root}/docs/assets/favicon.png",
            # without it, a schema that is not at localhost is sent to a validator on the network
            swagger_ui_parameters={"validatorUrl": None},
        )
        return HTMLResponse(page.body, headers=_HEADERS)

    @app.api_route("/redoc", methods=["GET", "HEAD"], include_in_schema=False)
    @app.api_route(f"{PREFIX}/redoc", methods=["GET", "HEAD"], include_in_schema=False)
    def redoc(request: Request) -> HTMLResponse:
        root = _root(request)
        page = get_redoc_html(
            openapi_url=f"{root}/openapi.json",
            title=app.title,
            redoc_js_url=f"{root}/docs/assets/redoc.standalone.js",
            redoc_favicon_url=f"{root}/docs/assets/favicon.png",
            with_google_fonts=False,
        )
        return HTMLResponse(page.body, headers=_HEADERS)

    @app.api_route(PROBLEMS_PAGE, methods=["GET", "HEAD"], include_in_schema=False)
    @app.api_route(f"{PREFIX}{PROBLEMS_PAGE}", methods=["GET", "HEAD"], include_in_schema=False)
    def problems() -> HTMLResponse:
        return HTMLResponse(_problems_page(app.title), headers=_HEADERS)

    @app.api_route("/docs/assets/{name}", methods=["GET", "HEAD"], include_in_schema=False)
    def asset(name: str) -> FileResponse:
        if name not in ASSETS:
            raise NotFoundError(f"there is no file {name}")
        return FileResponse(_FOLDER / name, media_type=ASSETS[name])


def _problems_page(title: str) -> str:
    """Every kind of problem: its code, which its type's address names, what it means and what to do."""
    items = "".join(
        f'<section id="{kind.type}"><h2><code>{kind.type}</code></h2><p><strong>{escape(kind.title)}</strong> '
        f"({kind.status})</p><p>{_as_html(meaning)}</p><p>{_as_html(remedy)}</p></section>"
        for kind, (meaning, remedy) in ((PROBLEMS[code], ADVICE[code]) for code in sorted(PROBLEMS))
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Problems: {escape(title)}</title>'
        '<meta name="viewport" content="width=device-width">'
        "<style>body{font:1rem/1.5 sans-serif;max-width:45rem;margin:2rem auto;padding:0 1rem}"
        "h2{margin:2rem 0 0}:target{background:#ffd}</style>"
        "<h1>Problems</h1><p>What went wrong is answered as <code>application/problem+json</code> (RFC 9457). "
        "<code>type</code> leads here; <code>code</code> is its last part, and the same at every installation. "
        "The status in brackets is that of an answer; jobs and media that failed have problems of the same kinds."
        f"</p>{items}</html>"
    )


def _as_html(text: str) -> str:
    """A text whose `names` are code."""
    return _CODE.sub(r"<code>\1</code>", escape(text))


def _root(request: Request) -> str:
    return str(request.scope.get("root_path", "")).rstrip("/")
