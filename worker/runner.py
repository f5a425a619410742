"""Claim -> work -> report: the frame around every job."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import structlog
from celery import Celery

from service.catalog import jobs
from service.catalog.database import Database
from service.catalog.jobs import Lease, Message
from service.catalog.models import Job, JobKind
from service.drafts import clear_drafts
from service.queue import send
from service.settings import Settings
from service.storage import Storage
from worker.failures import is_expected, problem_of
from worker.lease import CanceledError, LeaseKeeper, LeaseLostError
from worker.progress import ProgressScale

log = structlog.get_logger(__name__)


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


class Runner:
    """Does jobs, one after the other, in one pool child."""

    def __init__(self, settings: Settings, app: Celery) -> None:
        self._settings = settings
        self._app = app
        self._database = Database(settings.database)
        self._storage = Storage(settings)

    def run(self, job_id: str) -> None:
        """Do a job if it can be claimed: a message may be late, repeated, or of a job that was canceled."""
        with self._database.write() as session:
            lease = jobs.claim(session, job_id, now=self._database.now(), lease_s=self._settings.lease_s)
            job = jobs.get(session, job_id)
        if lease is None or job is None:
            log.info("nothing to claim", job=job_id)
            return
        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(job=job_id, kind=job.kind, attempt=job.attempt)
        log.info("job begins")
        with LeaseKeeper(self._database, lease, self._settings) as keeper:
            run = Run(
                self._settings,
                self._database,
                self._storage,
                job,
                lease,
                keeper,
                ProgressScale(keeper.report),
            )
            if job.started_at is not None:
                run.timings["queued_s"] = round((job.started_at - job.created_at).total_seconds(), 3)
            with run.drafts:
                self._work(run)
        self._release_waiting()
        # the reaper does it too, where it shares this machine's disk
        clear_drafts(self._settings, self._database, self._storage)

    def _work(self, run: Run) -> None:
        try:
            published = _work_of(JobKind(run.job.kind))(run)
            log.info("job ends" if published else "job ends unpublished: its lease is gone", **run.timings)
            if not published:
                self._confirm_cancel(run)
        except CanceledError:
            self._confirm_cancel(run)
        except LeaseLostError:
            log.warning("lease lost, work dropped")
        except Exception as error:
            if is_expected(error):
                log.info("job fails", error=str(error))
            else:
                log.exception("job fails unexpectedly")
            self._fail(run, error)

    def _fail(self, run: Run, error: Exception) -> None:
        with self._database.write() as session:
            now = self._database.now()
            failed = jobs.fail(session, run.lease, problem_of(error), now=now, timings=run.timings)
        if not failed:
            self._confirm_cancel(run)

    def _confirm_cancel(self, run: Run) -> None:
        with self._database.write() as session:
            if jobs.confirm_cancel(session, run.lease, now=self._database.now()):
                log.info("job canceled")

    def _release_waiting(self) -> None:
        """Let go, or fail, the jobs that waited for this one's medium. The reaper does it too, only later."""
        with self._database.write() as session:
            released = jobs.release(session, now=self._database.now())
        self._publish(released)

    def _publish(self, messages: Iterable[Message]) -> None:
        for message in messages:
            try:
                send(self._app, message)
            except Exception as error:
                log.warning("publish failed", waiting_job=message.job_id, error=type(error).__name__)
                return
            with self._database.write() as session:
                jobs.mark_published(session, message.job_id, now=self._database.now())


def _work_of(kind: JobKind) -> Callable[[Run], bool]:
    """The work of a kind of job. Loaded late: the method's libraries are heavy and not safe to fork."""
    if kind is JobKind.VECTORIZE:
        from worker.vectorizing import vectorize  # noqa: PLC0415

        return vectorize
    from worker.rendering import render  # noqa: PLC0415

    return render
