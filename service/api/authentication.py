"""Who asks: `Authorization: Bearer` with a key (RFC 6750, 2.1), before anything of a body is read.

Until the first key is made the service is open, and whoever asks is nobody; afterwards every call needs a key.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from sqlalchemy.orm import Session

from service.api.dependencies import ServicesDep
from service.api.services import Services
from service.catalog import Key, keys
from service.errors import Limit, QuotaExceededError, UnauthorizedError

BEARER = HTTPBearer(
    scheme_name="key",
    bearerFormat="pvg_…",
    description="A key made by `pvg-service keys create`. A service without keys needs none.",
    auto_error=False,
)


@dataclass(frozen=True)
class Caller:
    """Whose request it is; `service.catalog.keys.NOBODY` without keys."""

    owner: str
    credentials: HTTPAuthorizationCredentials | None = None


async def authenticate(
    request: Request,
    services: ServicesDep,
    given: Annotated[HTTPAuthorizationCredentials | None, Security(BEARER)],
) -> Caller:
    """The caller, whose requests of this minute are counted, and those that are not answered yet.

    Raises `UnauthorizedError`, and `QuotaExceededError` when there are too many of either.
    """
    key = await services.calls.read(_key_of, services, given)
    if key is None:
        return Caller(keys.NOBODY, given)
    limit = key.requests_per_minute
    standing = services.rates.take_held(key.id, limit)
    if standing is None:
        standing = await services.calls.write(services.rates.take, key.id, limit)
    request.state.answer_headers = {**getattr(request.state, "answer_headers", {}), **standing.headers}
    if not standing.granted:
        raise QuotaExceededError(
            f"this key may make {standing.limit} requests a minute",
            headers={"Retry-After": str(standing.resets_s)},
            limit=Limit(standing.limit, "requests per minute"),
        )
    services.places.take(request.scope["state"], key.id)
    return Caller(key.id, given)


CallerDep = Annotated[Caller, Depends(authenticate)]


async def check_again(services: Services, caller: Caller) -> None:
    """For answers that take long: raise `UnauthorizedError` for a key that was revoked or replaced meanwhile."""
    await services.calls.read(_key_of, services, caller.credentials)


def have_keys(services: Services) -> bool:
    """Whether there are keys."""
    with services.database.read() as session:
        return _exist(services, session)


def _exist(services: Services, session: Session) -> bool:
    """The same, kept for when the records are away."""
    services.known.has_keys = keys.exist(session)
    return services.known.has_keys


def _key_of(services: Services, given: HTTPAuthorizationCredentials | None) -> Key | None:
    with services.database.read() as session:
        if given is None:
            if _exist(services, session):
                raise UnauthorizedError("send a key as `Authorization: Bearer pvg_…`", invalid=False)
            return None
        key = keys.find(session, given.credentials, now=services.database.now())
        # refused all the same: who sends a key means its own things, and would share them with everybody here
        if key is None and not _exist(services, session):
            raise UnauthorizedError("this service has no keys and wants none: send no Authorization", invalid=True)
    if key is None:
        raise UnauthorizedError("this key is malformed, unknown, replaced or revoked", invalid=True)
    services.known.has_keys = True
    return key
