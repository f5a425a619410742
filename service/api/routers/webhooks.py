"""/webhooks: what was told to whom, telling it again, and what it is signed with."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from sqlalchemy.orm import Session

from service.api.authentication import Caller, CallerDep
from service.api.dependencies import DeliveryCursor, DeliveryId, PageSize, ServicesDep, problems
from service.api.idempotency import Once, OnceDep
from service.api.origins import write_of_own_site
from service.api.services import Services
from service.api.webhook_bodies import DeliveryBody, DeliveryPage, SecretBody, delivery_body, secret_body
from service.catalog import Delivery, DeliveryState, jobs, webhooks
from service.errors import ConflictError, NotFoundError

router = APIRouter(prefix="/webhooks", tags=["webhooks"])

#: stands for the secret among the things that kept answers are about
_SECRET = "webhook-secret"  # noqa: S105 - no secret


@router.get("", responses=problems())
async def list_webhooks(
    services: ServicesDep,
    caller: CallerDep,
    state: Annotated[list[DeliveryState], Query(description="repeat it to accept any of several states")] = [],  # noqa: B006 - copied
    job: Annotated[str | None, Query(description="id of a job: its deliveries only")] = None,
    cursor: DeliveryCursor = None,
    limit: PageSize = 50,
) -> DeliveryPage:
    """List the deliveries of webhooks, newest first."""
    job = job and job.replace("\0", "")
    return await services.calls.read(_page, services, caller, state, job, cursor, limit)


def _page(
    services: Services, caller: Caller, states: list[DeliveryState], job: str | None, cursor: str | None, limit: int
) -> DeliveryPage:
    with services.database.read() as session:
        found = webhooks.page(session, caller.owner, states=states, job_id=job, before=cursor, limit=limit + 1)
    shown = [delivery_body(delivery, job_state) for delivery, job_state in found[:limit]]
    return DeliveryPage(data=shown, next_cursor=shown[-1].id if len(found) > limit else None)


@router.get("/secret", dependencies=[Depends(write_of_own_site)], responses=problems(403, 507))
async def get_webhook_secret(response: Response, services: ServicesDep, caller: CallerDep) -> SecretBody:
    """Get the secret that webhooks are signed with. The first call makes it."""
    response.headers["Cache-Control"] = "no-store"
    known = await services.calls.read(_known_secret, services, caller)
    if known is not None:
        return known
    services.room.require()
    return await services.calls.write(_secret, services, caller)


def _known_secret(services: Services, caller: Caller) -> SecretBody | None:
    with services.database.read() as session:
        held = webhooks.known_secret(session, caller.owner)
    return None if held is None else secret_body(held, now=services.database.now())


def _secret(services: Services, caller: Caller) -> SecretBody:
    now = services.database.now()
    with services.database.write() as session:
        return secret_body(webhooks.secret(session, caller.owner, now=now), now=now)


@router.post("/secret/rotate", responses=problems(400, 409, 507))
async def rotate_webhook_secret(
    response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> SecretBody:
    """Replace the secret. For 24 h, messages are signed with the former one too; 409 while four such are valid."""
    async with once:
        once.compare(None)
        services.room.require()
        body = await services.calls.write(_rotate, services, caller, once)
    response.headers["Cache-Control"] = "no-store"
    return body


def _rotate(services: Services, caller: Caller, once: Once) -> SecretBody:
    now = services.database.now()
    with services.database.write() as session:
        try:
            rotated = webhooks.rotate(session, caller.owner, now=now)
        except webhooks.TooManySecretsError as error:
            raise _too_many_secrets(error.until, now=now) from error
        body = secret_body(rotated, now=now)
        once.keep(session, 200, body, location=None, resource_id=_SECRET)
    return body


def _too_many_secrets(until: datetime, *, now: datetime) -> ConflictError:
    wait_s = math.ceil((until - now).total_seconds())
    detail = f"{webhooks.FORMER_SECRETS} former secrets are signed with still; one of them ends in {wait_s} s"
    return ConflictError(detail, headers={"Retry-After": str(wait_s)})


@router.get("/{webhook_id}", responses=problems(404))
async def get_webhook(webhook_id: DeliveryId, services: ServicesDep, caller: CallerDep) -> DeliveryBody:
    """Get one delivery: an event for one receiver, and its attempts so far."""
    return await services.calls.read(_show, services, caller, webhook_id)


def _show(services: Services, caller: Caller, webhook_id: str) -> DeliveryBody:
    with services.database.read() as session:
        return _body(session, _found(session, caller, webhook_id))


@router.post("/{webhook_id}/replay", status_code=202, responses=problems(400, 404, 409, 507))
async def replay_webhook(
    webhook_id: DeliveryId, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> DeliveryBody:
    """Send an event again, at once and with the same id, whatever became of it before."""
    async with once:
        once.compare(None)
        return await services.calls.write(_replay, services, caller, once, webhook_id)


def _replay(services: Services, caller: Caller, once: Once, webhook_id: str) -> DeliveryBody:
    with services.database.write() as session:
        _found(session, caller, webhook_id)
        if not webhooks.replay(session, webhook_id, now=services.database.now()):
            raise ConflictError("the job has not ended: there is nothing to send yet")
        body = _body(session, _found(session, caller, webhook_id))
        once.keep(session, 202, body, location=None, resource_id=webhook_id)
    return body


def _found(session: Session, caller: Caller, webhook_id: str) -> Delivery:
    found = webhooks.get(session, webhook_id, owner=caller.owner)
    if found is None:
        raise NotFoundError(f"there is no webhook {webhook_id}")
    return found


def _body(session: Session, delivery: Delivery) -> DeliveryBody:
    job = jobs.get(session, delivery.job_id)
    assert job is not None, "a delivery goes away with its job"  # noqa: S101
    return delivery_body(delivery, job.state)
