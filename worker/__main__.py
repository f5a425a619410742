"""The worker's process: `python -P -m worker -A worker.app worker …`, as `pvg-service` starts it.

Celery looks in the current folder first for the app and for the modules of its tasks. Both are loaded here before
Celery begins, so that a package of the same name in that folder is never found.
"""

from __future__ import annotations

import sys

from celery.bin.celery import main

from service.logs import configure
from worker import app, tasks
from worker.beginning import close_output

__all__ = ["app", "tasks"]

if __name__ == "__main__":
    configure(app.settings.log_level)  # Celery warns of some things before it asks for that
    close_output()
    sys.exit(main())
