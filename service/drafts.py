"""What a process was writing when it was killed goes soon, from every disk that a living process of the service has."""

from __future__ import annotations

from collections.abc import Collection
from datetime import timedelta

from service.catalog import Database, sweep, utc_now
from service.settings import Settings
from service.spool import Spool


class Drafts:
    """The unfinished files of this machine. The reaper looks after them, and each worker, whose disk may be its own."""

    def __init__(self, database: Database, spool: Spool, settings: Settings) -> None:
        self._database = database
        self._spool = spool
        self._ttl = timedelta(seconds=settings.draft_ttl_s)

    def clear(self) -> int:
        """Remove those whose writer is gone; see `Spool.clear_drafts`. Returns their number."""
        # what the disk says of them is this machine's time, not the database's
        return self._spool.clear_drafts(held=self._held, before=utc_now() - self._ttl)

    def _held(self, job_ids: Collection[str]) -> set[str]:
        with self._database.read() as session:
            return sweep.held(session, job_ids)
