"""The query of a request: a name that its operation does not know, or one that is given twice, is refused.

It would be left out unsaid. But of a link that carries a signature what is unknown is passed over: it is handed on, and
mailers and pages add what they like to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_origin

from fastapi import Request
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from service.api.problems import invalid_values


async def check_parameters(request: Request) -> None:
    """Raise `ValidationFailedError` that names the parameters of the query that its route does not declare.

    And those that are given more than once and are no lists.
    """
    # not a plain function: FastAPI would call that in a thread of its own
    if not request.query_params:
        return
    route: APIRoute = request.scope["route"]
    known = dict(sorted(parameters_of(route.dependant)))
    given = [name for name, _ in request.query_params.multi_items()]
    errors: dict[str, str] = {}
    for name in sorted({*given}):
        if name not in known:
            errors[name] = f"there is no such parameter here; known are: {', '.join(known) or 'none'}"
        elif not known[name] and given.count(name) > 1:
            errors[name] = "it is given more than once"
    if "signature" in known and "signature" in given:
        errors = {name: detail for name, detail in errors.items() if name in known}
    if errors:
        raise invalid_values({f"/query/{name}": detail for name, detail in errors.items()})


def parameters_of(of: Dependant) -> Iterator[tuple[str, bool]]:
    """The parameters of a route, and of all that it depends on, and whether each is a list."""
    for one in of.query_params:
        yield one.alias, get_origin(one.field_info.annotation) is list
    for other in of.dependencies:
        yield from parameters_of(other)
