"""The API. `create_app` builds one from its settings; nothing is global."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from service.api import docs, openapi, problems
from service.api.draining import DrainBeforeRefusal
from service.api.middleware import RequestContext
from service.api.routers import ROUTERS
from service.api.services import make_services
from service.catalog import Clock, utc_now
from service.settings import Settings


def create_app(settings: Settings | None = None, *, clock: Clock = utc_now) -> FastAPI:
    """The application. The database must be migrated; workers may come and go."""
    settings = settings or Settings()
    services = make_services(settings, clock=clock)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        services.publisher.start()
        services.reaper.start()
        try:
            yield
        finally:
            await run_in_threadpool(services.reaper.stop)
            await run_in_threadpool(services.publisher.stop)
            services.database.close()

    app = FastAPI(
        title="Face colour transfer for portrait video",
        description="Upload a clip once; it is vectorised once. Each transfer only recolours it.",
        version="0.1.0",
        lifespan=lifespan,
        # FastAPI's own pages load their scripts from a content network
        docs_url=None,
        redoc_url=None,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
    )
    app.state.services = services
    app.add_middleware(DrainBeforeRefusal)
    app.add_middleware(RequestContext, root_path=settings.root_path)
    problems.install(app)
    for router in ROUTERS:
        app.include_router(router)
    openapi.install(app)
    docs.install(app)
    return app
