"""What is likely of jobs, from what was measured a moment ago."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from datetime import timedelta
from typing import Final

from sqlalchemy.orm import Session

from service.catalog import Database, Job, forecast
from service.catalog.forecast import Forecast, History
from service.settings import Settings

#: seconds for which what recent jobs took is not asked for again
_FRESH_S: Final = 15.0


class Forecasts:
    """Places and times of jobs for the answers of one API. Safe to use from several threads."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._database = database
        self._alive = timedelta(seconds=settings.silent_s)
        self._lock = threading.Lock()
        self._history = History()
        self._asked = float("-inf")

    def of(self, session: Session, found: Sequence[Job]) -> dict[str, Forecast]:
        """What is likely of those of the jobs that have not ended, by id."""
        if all(job.finished_at is not None for job in found):
            return {}
        since = self._database.now() - self._alive
        return forecast.forecasts(session, found, self._measured(session), alive_since=since)

    def _measured(self, session: Session) -> History:
        # one thread asks, the others take what there is
        if time.monotonic() - self._asked > _FRESH_S and self._lock.acquire(blocking=False):
            try:
                self._history = forecast.history(session)
                self._asked = time.monotonic()
            finally:
                self._lock.release()
        return self._history
