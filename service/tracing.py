"""W3C Trace Context: the `traceparent` of a request, kept with the jobs it makes and named in the log.

It is taken as it came and sent nowhere: the service has no spans of its own and calls nobody with it.
"""

from __future__ import annotations

import re
from contextvars import ContextVar
from typing import Final

# https://www.w3.org/TR/trace-context/#traceparent-header: version ff is none, nor are ids of zeros alone
_TRACEPARENT: Final = re.compile(r"(?!ff)([0-9a-f]{2})-(?!0{32})([0-9a-f]{32})-(?!0{16})[0-9a-f]{16}-[0-9a-f]{2}(-.*)?")
#: characters that are kept: those of version 00, which later ones begin with
_LENGTH: Final = 55

#: that of the request, or of the job, at work; None when it has none
traceparent: ContextVar[str | None] = ContextVar("traceparent", default=None)


def parse(header: str | None) -> str | None:
    """A `traceparent` as it is kept; None when there is none, or what there is is malformed."""
    found = _TRACEPARENT.fullmatch(header or "")
    if found is None or (found[1] == "00" and found[3] is not None):
        return None
    return found[0][:_LENGTH]


def trace_id(kept: str | None) -> str | None:
    """The trace's id, 32 hex digits, as logs name it."""
    return None if kept is None else kept.split("-")[1]
