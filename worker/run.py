"""One job being done, and what its work may use."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from service.catalog import Database, Job, Lease
from service.settings import Settings
from service.storage import Storage
from worker.lease import LeaseKeeper
from worker.progress import ProgressScale


@dataclass
class Run:
    """One job being done by this process."""

    settings: Settings
    database: Database
    storage: Storage
    job: Job
    lease: Lease
    keeper: LeaseKeeper
    progress: ProgressScale
    timings: dict[str, float] = field(default_factory=dict)
    drafts: ExitStack = field(default_factory=ExitStack)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Add the block's seconds to the job's timings."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.timings[name] = round(self.timings.get(name, 0.0) + time.perf_counter() - began, 3)

    def draft(self, suffix: str) -> Path:
        """A temporary path that is cleared when the run ends, whatever its end."""
        path = self.storage.draft(suffix, job_id=self.job.id)
        self.drafts.callback(path.unlink, missing_ok=True)
        return path
