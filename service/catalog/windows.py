"""Requests of a key, counted in windows that all processes share: a process is handed some of them at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from sqlalchemy.orm import Session

from service.catalog.models import Key

#: seconds of the window in which requests are counted
WINDOW_S: Final = 60


@dataclass(frozen=True)
class Share:
    """Requests of one window that were handed to one process."""

    window: int
    granted: int
    #: of all processes, this share included
    taken: int


def is_ahead(held: int, window: int) -> bool:
    """Requests were counted in a window that no clock can be in yet: the clock was set back, and they count no more."""
    return held > window + 1


def take_share(session: Session, key_id: str, *, window: int, wanted: int) -> Share:
    """Hand at most ``wanted`` of a key's requests of this window to a process; fewer, or none, when others have them.

    ``window`` counts `WINDOW_S` from 1970. A process whose clock is a little behind gets of the window that others are
    in; see `is_ahead` for a clock that was set back.
    """
    key = session.get(Key, key_id, with_for_update=True)
    if key is None:  # keys are never deleted by the service
        return Share(window, 0, 0)
    current = window if is_ahead(key.window_number, window) else max(window, key.window_number)
    taken = key.window_requests if key.window_number == current else 0
    granted = max(0, min(wanted, key.requests_per_minute - taken))
    key.window_number, key.window_requests = current, taken + granted
    session.flush()
    return Share(current, granted, taken + granted)
