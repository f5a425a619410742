"""The routes, one resource a module."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.routing import APIRoute

from service.api.routers import (
    events,
    health,
    jobs,
    metrics,
    pictures,
    preview,
    references,
    results,
    transfer,
    uploads,
    usage,
    videos,
    webhooks,
)

#: those that ask for no key, for another, or for one unless there is a link
OPEN_ROUTERS = (results.open_router, uploads.open_router, health.router, metrics.router)
#: every answer of these says the version of tus
TUS_ROUTERS = (uploads.router, uploads.open_router)
_MODULES = (videos, references, uploads, pictures, transfer, preview, jobs, events, webhooks, results, usage)
ROUTERS = (*(module.router for module in _MODULES), *OPEN_ROUTERS)


def _answer_head(router: APIRouter) -> None:
    """HEAD wherever there is GET, with its status and header fields (RFC 9110, 9.3.2); the server sends no body.

    It is the same operation, so the schema has it once.
    """
    routes = [route for route in router.routes if isinstance(route, APIRoute)]
    own = {route.path for route in routes if "HEAD" in (route.methods or ())}
    for route in routes:
        if "GET" in (route.methods or ()) and route.path not in own:
            router.add_api_route(
                route.path.removeprefix(router.prefix),
                route.endpoint,
                methods=["HEAD"],
                name=route.name,
                response_model=route.response_model,
                response_class=route.response_class,
                status_code=route.status_code,
                dependencies=route.dependencies,
                include_in_schema=False,
            )


for _router in ROUTERS:
    _answer_head(_router)

#: those whose first address has no version; like all they are at both
ROOT_ROUTERS = (health.router, metrics.router)

__all__ = ["OPEN_ROUTERS", "ROOT_ROUTERS", "ROUTERS", "TUS_ROUTERS"]
