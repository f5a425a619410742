"""/livez and /readyz: for process supervisors and load balancers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import structlog
from fastapi import APIRouter, Response

from service.api.dependencies import ServicesDep
from service.api.schemas import Readiness
from service.queue import RENDER

router = APIRouter(tags=["health"])
log = structlog.get_logger(__name__)


@router.get("/livez")
async def livez() -> dict[str, Literal["ok"]]:
    """The process answers."""
    return {"status": "ok"}


@router.get(
    "/readyz", responses={503: {"model": Readiness, "description": "the database or the storage does not answer"}}
)
def readyz(services: ServicesDep, response: Response) -> Readiness:
    """The parts answer. Without its broker the service is `degraded`: jobs are accepted and run once it is back."""
    checks: dict[str, Literal["ok", "unavailable"]] = {
        "database": _check("database", services.database.ping),
        "storage": _check("storage", services.storage.ping),
        "broker": _check("broker", lambda: services.publisher.depth(RENDER)),
    }
    if "unavailable" in (checks["database"], checks["storage"]):
        response.status_code = 503
        return Readiness(status="unavailable", checks=checks)
    return Readiness(status="ok" if checks["broker"] == "ok" else "degraded", checks=checks)


def _check(name: str, probe: Callable[[], object]) -> Literal["ok", "unavailable"]:
    try:
        probe()
    except Exception as error:
        log.warning("not ready", part=name, error=type(error).__name__)
        return "unavailable"
    return "ok"
