"""How many requests of one owner an API works on at a time: slow ones must not take all connections."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any, Final

from service.api.per_owner import PerOwner
from service.errors import Limit, QuotaExceededError

#: of a request's state: whose places it has
_HELD: Final = "places_of"


class Places:
    """Counts the requests of each owner until they are answered, up to ``per_owner``.

    Those by links count too, up to half of it for all links of an owner and an eighth for each: whoever has some can
    keep their owner neither from work nor from ending them. Those without an owner are not counted.
    """

    def __init__(self, per_owner: int) -> None:
        self._per_owner = per_owner
        self._of_links = max(1, per_owner // 2)
        self._of_one_link = max(1, per_owner // 8)
        self._of = PerOwner()

    def take(self, state: MutableMapping[str, Any], owner: str, *, link: str | None = None) -> None:
        """Give a request a place, until `leave`; ``state`` is that of the request, which is the owner's.

        ``link`` is the id of what the request's link is for, if it came by one. Raises `QuotaExceededError` when the
        owner, all of his links or this one have no more places.
        """
        if not owner or _HELD in state:
            return
        wanted = [(owner, self._per_owner, "a key")]
        if link is not None:
            wanted += [
                (f"links of {owner}", self._of_links, "the links of a key together"),
                (f"link to {link}", self._of_one_link, "a link"),
            ]
        for name, most, whose in wanted:
            if self._of.held(name) >= most:
                detail = f"{whose} may have {most} requests at a time; wait until some are answered"
                raise QuotaExceededError(detail, headers={"Retry-After": "5"}, limit=Limit(most, "requests at a time"))
        for name, _, _ in wanted:
            self._of.take(name)
        state[_HELD] = [name for name, _, _ in wanted]

    def leave(self, state: MutableMapping[str, Any]) -> None:
        """A request has ended, whether or not it had a place."""
        for name in state.pop(_HELD, ()):
            self._of.leave(name)


def has_place(state: MutableMapping[str, Any]) -> bool:
    """True for a request of an owner, until it has ended."""
    return _HELD in state
