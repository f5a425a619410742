"""Where this library keeps files of its own."""

from __future__ import annotations

import os
from pathlib import Path


def cache_root() -> Path | None:
    """Folder of what can be made again, networks and machine code: $PVG_CACHE_DIR, else ~/.cache/pvg.

    None for a user without a home folder, such as a number that a container was started with.
    """
    given = os.environ.get("PVG_CACHE_DIR")
    try:
        return Path(given).expanduser() if given else Path.home() / ".cache" / "pvg"
    except RuntimeError:
        return None
