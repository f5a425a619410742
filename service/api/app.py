"""The API. `create_app` builds one from its settings; nothing is global."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache

from fastapi import APIRouter, Depends, FastAPI
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.routing import BaseRoute

from service.addresses import PREFIX
from service.api import docs, idempotency, openapi, page, problems
from service.api.authentication import authenticate
from service.api.draining import DrainBeforeRefusal
from service.api.middleware import AnswerUnhandled, RequestContext
from service.api.origins import Cors, OwnHostAndOrigin
from service.api.query import check_parameters
from service.api.routers import OPEN_ROUTERS, ROOT_ROUTERS, ROUTERS, TUS_ROUTERS
from service.api.routers.uploads import speak
from service.api.services import Services, make_services
from service.settings import Settings
from service.version import VERSION


def create_app(settings: Settings | None = None) -> FastAPI:
    """The application. The database must be migrated; workers may come and go."""
    settings = settings or Settings()
    services = make_services(settings)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        services.room.watch()
        services.publisher.start()
        services.reaper.start()
        services.collector.start()
        services.deliverer.start()
        try:
            yield
        finally:
            parts = (services.reaper, services.collector, services.publisher, services.deliverer)
            await asyncio.gather(*(run_in_threadpool(part.stop) for part in parts))
            services.room.unwatch()
            services.close()

    app = FastAPI(
        title="Face colour transfer for portrait video",
        description="Upload a clip once; it is vectorised once. Each transfer only recolours it.",
        version=VERSION,
        lifespan=lifespan,
        # FastAPI would send traces, with bodies and messages in them, where the environment says so
        telemetry={"tracing": False, "metrics": False, "logs": False, "auto_configure": False},
        generate_unique_id_function=_name,
        # `docs` serves the schema; FastAPI's own pages load their scripts from a content network
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
    )
    app.state.services = services
    _surround(app, services)
    problems.install(app)
    idempotency.install(app)
    app.router.routes.extend(_routes())
    # the schema is made when it is asked for: it takes most of a second
    services.meters.name_routes(_paths())
    openapi.install(app)
    docs.install(app)
    page.install(app)
    return app


def _surround(app: FastAPI, services: Services) -> None:
    """Put the middleware around an application."""
    settings = services.settings
    # each surrounds those before it
    app.add_middleware(OwnHostAndOrigin, hosts=settings.host_names, origins=settings.origins)
    app.add_middleware(DrainBeforeRefusal)
    app.add_middleware(AnswerUnhandled)
    if settings.origins:
        app.add_middleware(
            Cors,
            allow_origins=sorted(settings.origins),
            allow_methods=["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"],
            allow_headers=["*"],
            expose_headers=[
                *("ETag", "Idempotent-Replayed", "Location", "Preference-Applied", "RateLimit", "RateLimit-Policy"),
                *("Pvg-Frame", "Repr-Digest", "Retry-After", "WWW-Authenticate", "X-Request-ID"),
                *("Accept-Ranges", "Content-Disposition", "Content-Range"),
                *("Tus-Resumable", "Tus-Version", "Tus-Extension", "Tus-Max-Size", "Tus-Checksum-Algorithm"),
                *("Upload-Offset", "Upload-Length", "Upload-Metadata", "Upload-Expires", "Pvg-Media"),
            ],
        )
    app.add_middleware(RequestContext, meters=services.meters, places=services.places, root_path=settings.root_path)


@cache
def _routes() -> tuple[BaseRoute, ...]:
    """The routes of all resources, each with the version before it and without.

    No setting changes them, and FastAPI takes a good part of a second for them at the first request: applications of
    one process share them.
    """
    shared = APIRouter(generate_unique_id_function=_name)
    for router in ROUTERS:
        # refusals of a key are of tus too
        dependencies = [Depends(speak)] if router in TUS_ROUTERS else []
        # a route's own body is read after this
        dependencies += [] if router in OPEN_ROUTERS else [Depends(authenticate)]
        # what watches a process may add what it likes to an address that has no parameters
        dependencies += [] if router in ROOT_ROUTERS else [Depends(check_parameters)]
        first, alias = _prefixes(router)
        shared.include_router(router, prefix=first, dependencies=dependencies)
        shared.include_router(router, prefix=alias, dependencies=dependencies, include_in_schema=False)
    return tuple(shared.routes)


def _paths() -> dict[str, str]:
    """The path of each route that the schema shows, by its name."""
    return {
        route.name: _prefixes(router)[0] + route.path
        for router in ROUTERS
        for route in router.routes
        if isinstance(route, APIRoute) and route.include_in_schema
    }


def _prefixes(router: APIRouter) -> tuple[str, str]:
    """What stands before the routes of a router: in the schema, and besides."""
    return ("", PREFIX) if router in ROOT_ROUTERS else (PREFIX, "")


def _name(route: APIRoute) -> str:
    return route.name
