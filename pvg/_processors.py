"""How many processors this process may use: libraries that count them themselves see all that the machine has."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Final

#: more are of little use to one clip, and each takes memory (`pvg.memory`)
MOST: Final = 8
#: threads of a decoder: libav's own number for two processors, on which memory was measured. It keeps ahead of drawing
_DECODING: Final = 3
_CGROUPS: Final = Path("/sys/fs/cgroup")


def processors() -> int:
    """How many one clip is worked on by: those that are usable, and at most `MOST`."""
    return min(usable_processors(), MOST)


def usable_processors() -> int:
    """By this process's affinity and the quota of its cgroups."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else _seen()
    return max(1, min(allowed, _quota(_CGROUPS)))


def are_more_seen() -> bool:
    """Whether a library that counts them itself may find more than `processors`."""
    return _seen() > processors()


def decoding_threads() -> int:
    """What to ask a decoder for; 0, its own choice, where there are no more than two."""
    return 0 if _seen() <= _DECODING - 1 else _DECODING


def _seen() -> int:
    return os.cpu_count() or 1


def _quota(root: Path, own: Path = Path("/proc/self/cgroup")) -> int:
    """How many the cgroups (version 2) of this process grant the time of, rounded up; all where they set no limit.

    ``root``: where they lie; a container sees its own there, whatever their name outside of it.
    """
    try:
        names = [line[3:] for line in own.read_text().splitlines() if line.startswith("0::")]
    except OSError:
        return _seen()
    granted = [_seen()]
    for name in names:
        path = root / name.strip("/")
        for folder in (path, *path.parents):
            if not folder.is_relative_to(root):
                break
            try:
                quota, period = (folder / "cpu.max").read_text().split()
                granted.append(math.ceil(int(quota) / int(period)))
            except (OSError, ValueError):  # none here: the root has no such file, and "max" is no number
                continue
    return min(granted)
