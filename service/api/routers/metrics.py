"""/metrics: figures for Prometheus."""

from __future__ import annotations

import hmac
from datetime import timedelta
from typing import Annotated

import structlog
from fastapi import APIRouter, Response, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from prometheus_client import CONTENT_TYPE_LATEST

from service.api.authentication import have_keys
from service.api.dependencies import ServicesDep, problems
from service.api.services import Services
from service.catalog import statistics
from service.catalog.statistics import Statistics
from service.errors import ServiceError, UnauthorizedError
from service.outages import is_outage

router = APIRouter(tags=["health"])
log = structlog.get_logger(__name__)

_BEARER = HTTPBearer(scheme_name="metrics", description="`PVG_METRICS_TOKEN`, where it is set.", auto_error=False)


@router.get(
    "/metrics",
    response_class=Response,
    responses={
        200: {"description": "the figures", "content": {"text/plain": {"schema": {"type": "string"}}}},
        **problems(),
    },
)
async def get_metrics(
    services: ServicesDep, given: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)]
) -> Response:
    """Get figures of requests, jobs, workers and files in Prometheus' text format."""
    found: Statistics | None = None
    await _check(services, given)
    try:
        found = await services.calls.read(_collect, services)
    except Exception as error:  # the figures of requests are worth the more
        if not _is_away(error):
            raise
        log.warning("metrics without the records", error=type(error).__name__)
    text = services.meters.text(found, services.room.free_bytes(), services.reaper.idle_s)
    return Response(text, media_type=CONTENT_TYPE_LATEST, headers={"Cache-Control": "no-store"})


async def _check(services: Services, given: HTTPAuthorizationCredentials | None) -> None:
    """Raise `UnauthorizedError` for who may not see them: they tell of what all keys do."""
    token = services.settings.metrics_token.get_secret_value()
    if token:
        if given is None or not hmac.compare_digest(given.credentials.encode(), token.encode()):
            raise UnauthorizedError("send PVG_METRICS_TOKEN as `Authorization: Bearer …`", invalid=given is not None)
    elif await _has_keys(services):
        raise UnauthorizedError("without PVG_METRICS_TOKEN only a service that has no keys shows them", invalid=False)


async def _has_keys(services: Services) -> bool:
    """Whether there are keys; while the records are away, whether there were any when they were last read."""
    try:
        return await services.calls.read(have_keys, services)
    except Exception as error:  # who asks learns no more of an outage than of anything else
        if not _is_away(error):
            raise
        return services.known.has_keys


def _is_away(error: Exception) -> bool:
    return isinstance(error, ServiceError) or is_outage(error)


def _collect(services: Services) -> Statistics:
    now = services.database.now()
    alive_since = now - timedelta(seconds=services.settings.silent_s)
    with services.database.read() as session:
        return statistics.collect(session, now=now, alive_since=alive_since)
