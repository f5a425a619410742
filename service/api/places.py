"""How many requests of one owner an API works on at a time: slow ones must not take all connections."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any, Final

from service.api.per_owner import PerOwner
from service.errors import Limit, QuotaExceededError

#: of a request's state: whose place it has
_OWNER: Final = "place_of"


class Places:
    """Counts the requests of each owner until they are answered, up to ``per_owner``.

    Those without an owner are not counted.
    """

    def __init__(self, per_owner: int) -> None:
        self._per_owner = per_owner
        self._of = PerOwner()

    def take(self, state: MutableMapping[str, Any], owner: str) -> None:
        """Give a request a place, until `leave`; ``state`` is that of the request, which is the owner's.

        Raises `QuotaExceededError` when the owner has them all.
        """
        if not owner or _OWNER in state:
            return
        if self._of.held(owner) >= self._per_owner:
            detail = f"a key may have {self._per_owner} requests at a time; wait until some are answered"
            raise QuotaExceededError(
                detail, headers={"Retry-After": "5"}, limit=Limit(self._per_owner, "requests at a time")
            )
        self._of.take(owner)
        state[_OWNER] = owner

    def leave(self, state: MutableMapping[str, Any]) -> None:
        """A request has ended, whether or not it had a place."""
        owner = state.pop(_OWNER, None)
        if owner is not None:
            self._of.leave(owner)
