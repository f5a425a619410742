"""How long things are kept from their last use, and which uses need no write for it."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Final

#: seconds after a use within which another is not counted, or that part of a retention, whichever is less
_LATELY_S: Final = 3600.0
_LATELY: Final = 24


def is_kept(expires_at: datetime, *, now: datetime, ttl_s: float) -> bool:
    """Whether the retention of a thing was counted anew so lately that a use by the way needs no write for it."""
    return expires_at > now + timedelta(seconds=ttl_s - min(_LATELY_S, ttl_s / _LATELY))
