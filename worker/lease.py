"""Keeps a job's lease alive while it is worked on, writes its progress to the database, and tells when to stop."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from datetime import datetime
from types import TracebackType
from typing import Self

import structlog
from sqlalchemy.orm import Session

from service.catalog import Database, JobState, Lease, Progress, leases
from service.settings import Settings
from worker import stopping
from worker.stopping import StoppedError

log = structlog.get_logger(__name__)

#: seconds between two looks at whether the worker has to stop, or the job is canceled
_LOOK_S = 1.0
#: for one look at the database, after which it is called slow
_SLOW_S = 2.0


class LeaseLostError(Exception):
    """Somebody else may have the job by now: stop, publish nothing."""


class CanceledError(Exception):
    """The job is being canceled: stop."""


class LeaseKeeper:
    """A thread beside the work. Only it uses the database meanwhile, so that a slow database never slows the work.

    The lease of a worker whose database is away runs out, but nobody can take the job over without the database either:
    the work goes on, and the lease is renewed when the database is back (`Reaper` leaves time for it). Only after
    `Settings.max_outage_s` it stops.

    When the worker has to stop and the job will not end in time, ``give_back`` is called in the thread, so that another
    worker can have the job before the work has noticed.
    """

    def __init__(
        self, database: Database, lease: Lease, settings: Settings, give_back: Callable[[], None] | None = None
    ) -> None:
        self._give_back = give_back
        self._database = database
        self._lease = lease
        self._settings = settings
        self._latest: Progress | None = None
        self._verdict: type[Exception] | None = None
        self._began = self._renewed = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"lease-{lease.job_id}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()

    def report(self, progress: Progress) -> None:
        """Leave the progress to be written when its time has come; raise when the work has to stop."""
        self._latest = progress
        self.check()

    def flush(self) -> None:
        """Write the progress now, for an end that is near: a job may be shorter than the time between two ticks."""
        if self._latest is not None:
            try:
                with self._database.write() as session:
                    self._write(session, self._latest, self._database.now())
            except Exception as error:  # progress never fails a job
                log.warning("progress not written", job=self._lease.job_id, error=type(error).__name__)

    def check(self) -> None:
        """Raise `CanceledError`, `LeaseLostError` or `StoppedError` when the work has to stop."""
        if self._verdict is None and not self._may_go_on():
            self._verdict = StoppedError
        if self._verdict is not None:
            raise self._verdict

    def _may_go_on(self) -> bool:
        fraction = self._latest.fraction if self._latest is not None else None
        return stopping.may_go_on(self._began, fraction, grace_s=self._settings.worker_stop_grace_s)

    def _run(self) -> None:
        self._keep()
        if self._verdict is StoppedError and self._give_back is not None:
            try:
                self._give_back()
            except Exception as error:  # the lease runs out, and the reaper queues the job again
                log.warning("job not given back", job=self._lease.job_id, error=type(error).__name__)

    def _keep(self) -> None:
        written: Progress | None = None
        interval_s, written_at = self._settings.progress_interval_s, -math.inf
        while self._verdict is None and not self._stop.wait(min(interval_s, _LOOK_S) or 0.1):
            if not self._may_go_on():
                self._verdict = StoppedError
                return
            began = time.monotonic()
            try:
                latest = self._latest
                if latest == written or began - written_at < interval_s:
                    self._tick(None)
                else:
                    self._tick(latest)
                    written, written_at = latest, began
                if (taken := time.monotonic() - began) > _SLOW_S:
                    log.warning("lease upkeep is slow", job=self._lease.job_id, seconds=round(taken, 1))
            except Exception as error:  # progress never fails a job; a database that stays away does
                log.warning("lease upkeep failed", job=self._lease.job_id, error=type(error).__name__)
                if time.monotonic() - self._renewed > self._settings.max_outage_s:
                    self._verdict = LeaseLostError

    def _write(self, session: Session, progress: Progress, now: datetime) -> None:
        every_s = self._settings.progress_interval_s
        leases.report(session, self._lease, progress, now=now, whole_every_s=every_s)

    def _tick(self, progress: Progress | None) -> None:
        now = self._database.now()
        due = time.monotonic() - self._renewed >= self._settings.heartbeat_s
        with self._database.write() if due or progress is not None else self._database.read() as session:
            if progress is not None:
                self._write(session, progress, now)
            if due:
                leases.renew(session, self._lease, now=now, lease_s=self._settings.lease_s)
            state = leases.held_state(session, self._lease)
        if due:
            self._renewed = time.monotonic()
        if self._verdict is not None:
            return  # it was told to stop meanwhile, and gives the job back, or ends it if it is canceled
        if state is None:
            self._verdict = LeaseLostError
        elif state is JobState.CANCELING:
            self._verdict = CanceledError
