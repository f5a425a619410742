"""`Prefer` (RFC 7240): what a client would like, and the server may do."""

from __future__ import annotations

import re
from collections.abc import Sequence

# a list of preferences whose parameters say nothing here
_WAIT = re.compile(r"wait\s*=\s*(?:\"(\d{1,9})\"|(\d{1,9}))", re.IGNORECASE)


def preferred_wait_s(lines: Sequence[str], *, most_s: int) -> int | None:
    """The seconds of the first `wait` in Prefer headers, at most ``most_s``; None when there is none."""
    for preference in ",".join(lines).split(","):
        found = _WAIT.fullmatch(preference.partition(";")[0].strip())
        if found:
            return min(most_s, int(found[1] or found[2]))
    return None
