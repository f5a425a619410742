"""No process outlives the one that started it, however that one ends."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

#: set by `pvg-service serve`: the process without which the worker must not run
STARTER = "PVG_STARTER_PID"
_PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Have the kernel kill this process when its parent ends (Linux; elsewhere nothing happens)."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def die_with_starter() -> None:
    """The same for the worker's main process, when it was started by another that says so."""
    starter = os.environ.get(STARTER)
    if starter is None:
        return
    die_with_parent()
    if os.getppid() != int(starter):  # it ended before the kernel was told
        sys.exit(1)
