"""What the caller may do, and how much of it is used."""

from __future__ import annotations

from pvg_client.calls import Api, Flow, asked
from pvg_client.models import Limits, Usage


def usage(api: Api) -> Flow[Usage]:
    """What the key has used of its limits; without keys, what everybody has used."""
    return (yield from asked(api, Usage.of, "GET", "/usage"))


def limits(api: Api) -> Flow[Limits]:
    """All limits that the caller is under, with the formats and options that the service has."""
    return (yield from asked(api, Limits.of, "GET", "/limits"))
