"""The routes, one resource a module."""

from __future__ import annotations

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
_MODULES = (videos, references, uploads, pictures, transfer, preview, jobs, events, webhooks, results, usage)
ROUTERS = (*(module.router for module in _MODULES), *OPEN_ROUTERS)

#: those whose first address has no version; like all they are at both
ROOT_ROUTERS = (health.router, metrics.router)

__all__ = ["OPEN_ROUTERS", "ROOT_ROUTERS", "ROUTERS"]
