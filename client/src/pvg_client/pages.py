"""Lists that come in pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pvg_client.calls import Api, Flow, Params, asked
from pvg_client.models import Body

T = TypeVar("T")


def each(values: Sequence[str] | str) -> Sequence[str]:
    """Values to filter by; one needs no list: as a sequence a text would be its letters."""
    return [values] if isinstance(values, str) else values


@dataclass(frozen=True, slots=True)
class Listing(Generic[T]):
    """A list of the service: where it is, what of it is wanted, and how one of its things is read."""

    path: str
    params: Params
    read: Callable[[Any], T]

    def page(self, api: Api, cursor: str | None) -> Flow[tuple[list[T], str | None]]:
        """The things of one page, and the cursor of the next."""
        params = [*self.params, ("cursor", cursor)] if cursor is not None else self.params
        return (yield from asked(api, self._page, "GET", self.path, params=params))

    def _page(self, body: Body) -> tuple[list[T], str | None]:
        return [self.read(one) for one in body["data"]], body.get("next_cursor")
