"""The process of previews: `python -P -m worker.previews -A worker.previews.app worker …`, see `worker.__main__`."""

from __future__ import annotations

import sys

from celery.bin.celery import main

from service.logs import configure
from worker.beginning import close_output
from worker.previews import app

__all__ = ["app"]

if __name__ == "__main__":
    configure(app.settings.log_level)  # Celery warns of some things before it asks for that
    close_output()
    sys.exit(main())
