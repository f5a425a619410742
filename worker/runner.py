"""Claim -> work -> report: the frame around every job."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from datetime import timedelta

import structlog
from celery import Celery

from service.catalog import Database, JobKind, Message, jobs, sweep
from service.queue import send
from service.settings import Settings
from service.storage import Storage
from worker.failures import is_expected, problem_of
from worker.lease import CanceledError, LeaseKeeper, LeaseLostError
from worker.progress import ProgressScale
from worker.run import Run

log = structlog.get_logger(__name__)


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
        before = self._database.now() - timedelta(seconds=self._settings.draft_ttl_s)
        self._storage.clear_drafts(held=self._held, before=before)

    def _held(self, job_ids: Collection[str]) -> set[str]:
        with self._database.read() as session:
            return sweep.held(session, job_ids)

    def _work(self, run: Run) -> None:
        try:
            published = _work_of(JobKind(run.job.kind))(run)
            log.info("job ends" if published else "job ends unpublished: its lease is lost", **run.timings)
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
        """Release, or fail, the jobs that waited for this one's medium. The reaper does it too, only later."""
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
