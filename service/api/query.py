"""The query of a request: a name that its operation does not know is refused: it would be left out unsaid.

But not of a link that carries a signature: it is handed on, and mailers and pages add what they like to it.
"""

from __future__ import annotations

from collections.abc import Iterator

from fastapi import Request
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from service.api.problems import invalid_values


async def refuse_unknown(request: Request) -> None:
    """Raise `ValidationFailedError` that names the parameters of the query that its route does not declare."""
    # not a plain function: FastAPI would call that in a thread of its own
    if not request.query_params or "signature" in request.query_params:
        return
    route: APIRoute = request.scope["route"]
    known = sorted({*_names(route.dependant)})
    if unknown := sorted({*request.query_params} - {*known}):
        detail = f"there is no such parameter here; known are: {', '.join(known) or 'none'}"
        raise invalid_values({f"/query/{name}": detail for name in unknown})


def _names(of: Dependant) -> Iterator[str]:
    """The parameters of a route, and of all that it depends on."""
    yield from (one.alias for one in of.query_params)
    for other in of.dependencies:
        yield from _names(other)
