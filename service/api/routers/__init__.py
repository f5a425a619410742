"""The routes, one resource a module."""

from __future__ import annotations

from service.api.routers import health, jobs, references, results, transfer, videos

ROUTERS = tuple(module.router for module in (videos, references, transfer, jobs, results, health))

__all__ = ["ROUTERS"]
