"""The API. `create_app` builds one from its settings; nothing is global."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from service import problems
from service.broker import make_folders
from service.catalog.database import Clock, Database, utc_now
from service.context import RequestContext, Services
from service.draining import DrainBeforeRefusal
from service.openapi import document
from service.queue import Publisher
from service.reaper import Reaper
from service.routers import health, jobs, references, results, transfer, videos
from service.settings import Settings
from service.storage import Storage


def make_services(settings: Settings, *, clock: Clock = utc_now) -> Services:
    """The parts of an API, not started yet."""
    make_folders(settings)
    database = Database(settings.database, clock=clock)
    storage = Storage(settings)
    publisher = Publisher(settings, database)
    return Services(settings, database, storage, publisher, Reaper(settings, database, storage, publisher))


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
        root_path=settings.root_path,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
    )
    app.state.services = services
    app.add_middleware(DrainBeforeRefusal)
    app.add_middleware(RequestContext)
    problems.install(app)
    for module in (videos, references, transfer, jobs, results, health):
        app.include_router(module.router)
    document(app)
    return app
