"""The threads of one test: its process has others, which tests before it may have left and which end meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Callable


def own_threads(prefix: str = "") -> Callable[[], list[str]]:
    """What names those that have begun since, are alive, and have a name that begins so."""
    others = set(threading.enumerate())
    return lambda: [one.name for one in set(threading.enumerate()) - others if one.name.startswith(prefix)]
