"""/livez and /readyz: for process supervisors and load balancers."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from datetime import timedelta
from typing import Final

from fastapi import APIRouter, Response
from sqlalchemy.exc import SQLAlchemyError

from service.api.dependencies import ServicesDep
from service.api.probes import FULL, OK, UNAVAILABLE
from service.api.schemas import Liveness, Readiness
from service.api.services import Services
from service.catalog import collecting, workers
from service.errors import UnavailableError

router = APIRouter(tags=["health"])

NO_WORKER: Final = "none"
#: what workers may lack for a while, and jobs wait for
_LACKED: Final = (workers.BROKER, workers.DISK)
#: the states of workers with which jobs are taken in
_WAITED_FOR: Final = frozenset({OK, NO_WORKER, *(f"no {lacked}" for lacked in _LACKED)})


@router.get("/livez")
async def get_liveness() -> Liveness:
    """Tell that the process answers."""
    return Liveness(status="ok")


@router.get(
    "/readyz",
    responses={
        503: {"model": Readiness, "description": "database or storage do not answer, no worker can work, or it stops"}
    },
)
async def get_readiness(services: ServicesDep, response: Response) -> Readiness:
    """Whether requests should come here, and which parts answer.

    `degraded`: jobs are accepted, and run once the broker, a worker, or the disk of one, is back; or the `storage` is
    `full`: all goes on but what needs room; or the `collector` keeps files without a record, since they may be another
    database's.
    """
    if services.watch.is_closed:
        response.status_code = 503
        return Readiness(status="stopping", checks={})
    database, storage, broker = await asyncio.gather(*(probe.state() for probe in services.probes))
    if storage == OK and services.room.is_short():
        storage = FULL
    checks: dict[str, str] = {"database": database, "storage": storage, "broker": broker}
    checks |= {"workers": UNAVAILABLE, "collector": UNAVAILABLE}
    if database == OK:
        try:
            checks["workers"], checks["collector"] = await services.calls.read(_others, services)
        except (SQLAlchemyError, UnavailableError):  # since the check
            checks["database"] = UNAVAILABLE
    if UNAVAILABLE in (checks["database"], storage) or checks["workers"] not in _WAITED_FOR:
        response.status_code = 503
        return Readiness(status="unavailable", checks=checks)
    return Readiness(status="ok" if set(checks.values()) == {OK} else "degraded", checks=checks)


def _others(services: Services) -> tuple[str, str]:
    """Whether a worker can do jobs, what all of them lack, or that there is none; and why no files are collected."""
    since = services.database.now() - timedelta(seconds=services.settings.silent_s)
    with services.database.read() as session:
        lacking = workers.lacking(session, since=since)
        halted = collecting.halted(session)
    return _able(lacking), f"halted: {halted}" if halted else OK


def _able(lacking: Collection[str | None]) -> str:
    """What workers can do, by what each of them lacks."""
    if None in lacking:
        return OK
    for lacked in _LACKED:
        if lacked in lacking:
            return f"no {lacked}"
    return f"no {min(filter(None, lacking))}" if lacking else NO_WORKER
