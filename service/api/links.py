"""Who asks, by a key or by a signed link."""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Security
from fastapi.security import HTTPAuthorizationCredentials
from sqlalchemy.orm import Session

from service.api.authentication import BEARER, authenticate
from service.api.dependencies import ServicesDep
from service.api.services import Services
from service.catalog import keys
from service.errors import ForbiddenError


@dataclass(frozen=True)
class Access:
    """A caller with a key, or the holder of a link, which says itself what it is for."""

    owner: str | None
    by: str = keys.NOBODY
    expires: str = ""
    signature: str = ""

    @property
    def by_link(self) -> bool:
        """True without a key."""
        return self.owner is None

    def to(self, services: Services, session: Session, *what: str) -> datetime | None:
        """When the link to this expires; None for a caller with a key. Raises `ForbiddenError` and `GoneError`."""
        if not self.by_link:
            return None
        seals = keys.seals(session, self.by, now=services.database.now())
        return services.signer.check(*what, by=self.by, seals=seals, expires=self.expires, signature=self.signature)

    def count(self, services: Services, state: MutableMapping[str, Any], owner: str, what: str) -> None:
        """Count a request for what is an owner's, and has this id, in its minute and until it is answered.

        One with a key has been counted. Raises `QuotaExceededError`.
        """
        if self.by_link and owner:
            services.link_rates.take(what)
            services.places.take(state, owner, link=what)

    def check_owner(self, session: Session, owner: str) -> None:
        """Raise `ForbiddenError` for a link that was made by another owner than what it is for has now.

        And for one of a key that was revoked, or of nobody since there are keys.
        """
        if not self.by_link:
            return
        if owner != self.by:
            raise ForbiddenError("what this link is for belongs to another key now; ask for another link")
        key = keys.get(session, owner)
        if keys.exist(session) if key is None else key.revoked_at is not None:
            raise ForbiddenError("the key that this link was made with may no longer be used")


async def _access(
    request: Request,
    services: ServicesDep,
    given: Annotated[HTTPAuthorizationCredentials | None, Security(BEARER)],
    expires: Annotated[str, Query(max_length=20, description="part of a signed link")] = "",
    by: Annotated[str, Query(max_length=40, description="part of a signed link")] = keys.NOBODY,
    signature: Annotated[
        str | None, Query(max_length=100, description="part of a signed link, which needs no key")
    ] = None,
) -> Access:
    if signature is None:
        return Access((await authenticate(request, services, given)).owner)
    return Access(None, by, expires, signature)


AccessDep = Annotated[Access, Depends(_access)]
