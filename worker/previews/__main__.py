"""The process of previews: `python -P -m worker.previews -A worker.previews.app worker …`, see `worker.__main__`."""

from __future__ import annotations

import sys

from celery.bin.celery import main

from worker.previews import app

__all__ = ["app"]

if __name__ == "__main__":
    sys.exit(main())
