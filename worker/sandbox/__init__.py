"""Work on media in processes that can be killed, see one job's files alone, and hold no credentials.

The worker keeps one *fork server*, which has loaded all libraries and never sees a medium. For each call of a job it
forks a process that gives up what it does not need, does the call, and ends; one for previews stays a while, with one
clip open. The pool child that supervises the job has the database and the storage, and never decodes anything. See
docs/security.md and docs/decisions/0019.
"""

from __future__ import annotations

from worker.sandbox.client import (
    CrashError,
    FileLimitError,
    LimitError,
    MemoryLimitError,
    MethodError,
    NoRoomError,
    Sandbox,
    Session,
    TimeLimitError,
    UnforkedError,
    Watch,
)
from worker.sandbox.confinement import Limits, View
from worker.sandbox.faults import with_causes
from worker.sandbox.keeper import SandboxServer

__all__ = [
    "CrashError",
    "FileLimitError",
    "LimitError",
    "Limits",
    "MemoryLimitError",
    "MethodError",
    "NoRoomError",
    "Sandbox",
    "SandboxServer",
    "Session",
    "TimeLimitError",
    "UnforkedError",
    "View",
    "Watch",
    "with_causes",
]
