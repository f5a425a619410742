"""A worker that cannot begin ends, for whoever started it to start it again.

Celery only logs what goes wrong as a worker begins: it would go on, and fail each job that it takes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import structlog

log = structlog.get_logger(__name__)


@contextmanager
def or_end() -> Iterator[None]:
    """Inside the block an error ends this process, with status 1."""
    try:
        yield
    except Exception:
        log.exception("the worker cannot begin, and ends")
        sys.exit(1)


def close_output() -> None:
    """Throw away what a worker writes to standard output: Celery tells there in words, beside its log, that it stops.

    What another command of Celery's answers, or a worker's ``--help``, is written.
    """
    if "worker" not in sys.argv[1:] or "--help" in sys.argv:
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
