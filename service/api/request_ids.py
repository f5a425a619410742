"""The id of a request, by which its answer, its log lines and what it makes are found."""

from __future__ import annotations

import re
from typing import Final

from starlette.datastructures import Headers
from starlette.types import Scope

from service.ids import new_id

_ACCEPTED: Final = re.compile(r"[A-Za-z0-9._-]{1,128}")


def request_id_of(scope: Scope) -> str:
    """The X-Request-ID that a request brings, if it is harmless, or one of ours: the same whoever asks first."""
    state = scope.setdefault("state", {})
    if "request_id" not in state:
        given = Headers(scope=scope).get("x-request-id", "")
        state["request_id"] = given if _ACCEPTED.fullmatch(given) else new_id("req")
    return str(state["request_id"])
