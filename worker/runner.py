"""Claim -> work -> report: the frame around every job."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from functools import partial
from typing import Final, TypeVar

import structlog
from celery import Celery
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session

from service import tracing
from service.blobs import Blobs, was_marked
from service.catalog import (
    Database,
    Job,
    JobKind,
    Lease,
    Message,
    PartKind,
    fairness,
    jobs,
    leases,
    media,
    parts,
    tombstones,
)
from service.catalog.fairness import Taken
from service.outages import is_disk_full, is_outage
from service.queue import send, withdraw
from service.room import Room
from service.settings import Settings
from service.storage import Storage
from worker import stopping
from worker.failures import LostAssetsError, LostPartsError, UnreadyError, is_expected, lacks_room, problem_of
from worker.lease import CanceledError, LeaseKeeper, LeaseLostError
from worker.parts import draw_part, join, render_or_split
from worker.patience import Patience
from worker.progress import ProgressScale
from worker.run import Run
from worker.sandbox import CrashError, MethodError, Sandbox, UnforkedError
from worker.stopping import StoppedError
from worker.vectorizing import vectorize

#: seconds for which a worker with a message waits for room on its disk, and between two looks
ROOM_WAIT_S: Final = 8.0
ROOM_POLL_S: Final = 0.5
#: for which a worker keeps a job that failed for its own machine: it is not to outrun those that are well
FAULT_PAUSE_S: Final = 8.0

#: why no job is begun
_NO_ROOM: Final = "no room for jobs on the disk"
_NOT_WRITTEN: Final = "no job is begun while the disk cannot be written"

log = structlog.get_logger(__name__)

T = TypeVar("T")


class Runner:
    """Supervises jobs, one after the other, in one pool child; media are worked on in the processes of ``sandbox``."""

    def __init__(self, settings: Settings, app: Celery, sandbox: Sandbox) -> None:
        self._settings = settings
        self._app = app
        self._sandbox = sandbox
        self._room = Room(settings)
        self._database = Database(settings.database, before_freeing=self._room.give_back)
        self._storage = Storage(settings, was_marked=partial(was_marked, self._database))
        # recorded when all of a job's are written, and stores may be away in between
        self._blobs = Blobs(self._database, self._storage, within_s=settings.job_hard_limit_s)

    def run(self, job_id: str) -> None:
        """Do a job if one can be claimed: a message may be late, repeated, or of a job that was canceled.

        The job done is another one when it is that one's turn. Raises `StoppedError` when the worker is told to stop
        before a job is claimed.
        """
        structlog.contextvars.clear_contextvars()  # of the job before
        stopping.check()
        limit_s = self._settings.max_outage_s
        patience = Patience(stopping.check, limit_s=limit_s)
        if not patience(lambda: self._has_room(job_id)):
            return
        token = leases.new_token()
        claimed = patience(lambda: self._claim(job_id, token))
        if claimed is None:
            log.info("nothing to claim", job=job_id)
            return
        taken, job = claimed
        lease = taken.lease
        _name_in_logs(job)
        tracing.traceparent.set(job.traceparent)  # jobs that this one makes are of its trace
        log.info("job begins")
        with LeaseKeeper(self._database, lease, self._settings, lambda: self._give_back(job, lease)) as keeper:
            if taken.deferred is not None:  # a broker that is away takes its time
                self._publish([taken.deferred])
            run = Run(
                settings=self._settings,
                database=self._database,
                storage=self._storage,
                blobs=self._blobs,
                job=job,
                lease=lease,
                keeper=keeper,
                progress=ProgressScale(keeper.report),
                sandbox=self._sandbox,
                patience=Patience(keeper.check, limit_s=limit_s),
                timings=dict(job.timings or {}),
            )
            if job.started_at is not None:
                run.timings["queued_s"] = round((job.started_at - job.queued_at).total_seconds(), 3)
            with run.drafts:
                self._work(run)
        self._publish(run.messages)
        self._tidy_up()

    def _claim(self, job_id: str, token: str) -> tuple[Taken, Job] | None:
        with self._database.write() as session:
            now, lease_s = self._database.now(), self._settings.lease_s
            # by a call before, whose answer was lost; the job that it left to another is sent again by the reaper
            lease = leases.claimed(session, token)
            taken = Taken(lease) if lease is not None else None
            taken = taken or fairness.claim(session, job_id, now=now, lease_s=lease_s, token=token)
            job = jobs.get(session, taken.lease.job_id) if taken is not None else None
        return None if taken is None or job is None else (taken, job)

    def _tidy_up(self) -> None:
        """What may be done after a job; the reaper does it too, only later."""
        try:
            self._release_waiting()
        except Exception as error:
            if not _may_pass(error):
                raise
            log.warning("left to the reaper", error=type(error).__name__)

    def _has_room(self, job_id: str) -> bool:
        """Wait a little for a disk with room that can be written. False when there is none: the job is left for later.

        Its message is sent again, and may come to another worker.
        """
        until = time.monotonic() + ROOM_WAIT_S
        waited = False
        while (why := self._unfit()) is not None:
            if not waited:
                waited = True
                log.warning(why, job=job_id)
                if not self._put_off(job_id, leases.NO_ROOM if why == _NO_ROOM else None):
                    return True  # nothing to wait for: the claim finds out
            if time.monotonic() >= until:
                return False
            stopping.check()
            time.sleep(ROOM_POLL_S)
        return True

    def _put_off(self, job_id: str, stage: str | None) -> bool:
        """Record that a job waits for this machine's disk; False for one that cannot be claimed."""
        try:
            with self._database.write() as session:
                return leases.put_off(session, job_id, now=self._database.now(), stage=stage)
        except DBAPIError as error:
            if not is_disk_full(error):
                raise
            return True  # there is no room for that either; the reaper sends its message again

    def _unfit(self) -> str | None:
        """Why no job can be begun on this machine's disk; None when one can."""
        try:
            if self._room.is_short():
                return _NO_ROOM
            self._storage.spool.check_drafts()
        except OSError as error:
            return _NO_ROOM if is_disk_full(error) else _NOT_WRITTEN
        return None

    def _work(self, run: Run) -> None:
        try:
            published = _done(run)
            log.info("job ends" if published else "job ends unpublished: its lease is lost", **run.timings)
            if not published:
                self._confirm_cancel(run.lease)
        except CanceledError:
            self._confirm_cancel(run.lease)
        except LeaseLostError:
            log.warning("lease lost, work dropped")
        except StoppedError:
            log.info("work dropped: the worker has to stop")  # its keeper gives the job back
        except SystemExit:  # this pool process alone was told to end
            self._give_back(run.job, run.lease)
            raise
        except (UnreadyError, LostAssetsError, LostPartsError) as error:
            self._begin_again(run, error)
        except Exception as error:
            if lacks_room(error):
                run.drafts.close()  # the records need some
            if run.job.attempt < self._settings.max_attempts and (why := _worth_another_attempt(error)):
                log.warning(why, error=str(error) if isinstance(error, CrashError) else type(error).__name__)
                self._give_back(run.job, run.lease, costs_attempt=True)
                return
            if is_expected(error):
                log.info("job fails", error=str(error))
            else:
                log.exception("job fails unexpectedly", trace=error.trace if isinstance(error, MethodError) else None)
            self._fail(run, error)

    def _begin_again(self, run: Run, error: UnreadyError | LostAssetsError | LostPartsError) -> None:
        """Have the job begin anew once it has what it lacks now, or fail where it would lack it for ever."""
        match error:
            case UnreadyError():
                self._wait_again(run, error)
            case LostAssetsError():
                self._make_again(run, error)
            case LostPartsError():
                self._draw_again(run, error)

    def _wait_again(self, run: Run, error: UnreadyError) -> None:
        """Have the job wait for its media, also when they are ready by now: then it is released at once."""
        log.info("job waits: its media are made again", media=sorted(error.media_ids))
        if not self._at_last(lambda session, now: leases.wait_again(session, run.lease, now=now)):
            self._confirm_cancel(run.lease)

    def _make_again(self, run: Run, error: LostAssetsError) -> None:
        """Have lost assets made again from their sources, and the job wait for them; once, then it fails."""
        messages = self._at_last(lambda session, now: media.make_again(session, run.lease, error.assets, now=now))
        if messages is None:
            log.error("job fails: an asset that was made again cannot be read", media=sorted(error.assets))
            self._fail(run, error)
            return
        log.warning("assets are lost; they are made again", media=sorted(error.assets))
        self._publish(messages)
        if not messages:
            self._confirm_cancel(run.lease)

    def _draw_again(self, run: Run, error: LostPartsError) -> None:
        """Have a job in parts begin anew, as often as other jobs are tried; then it fails."""
        most = self._settings.max_attempts
        message = self._at_last(lambda session, now: leases.draw_again(session, run.lease, now=now, max_attempts=most))
        if message is None:
            log.error("job fails: its parts cannot be joined", error=str(error))
            self._fail(run, error)
            return
        log.warning("parts are lost or damaged; they are drawn again", error=str(error))
        self._publish([message])

    def _fail(self, run: Run, error: Exception) -> None:
        def fail(session: Session, now: datetime) -> list[Message] | None:
            """The messages of its other parts, which are not needed any more; None when the lease is lost."""
            whole_id = run.job.parent_id
            others = [] if whole_id is None else parts.messages(session, [whole_id])
            failed = leases.fail(session, run.lease, problem_of(error), now=now, timings=run.timings)
            return others if failed else None

        needless = self._at_last(fail)
        if needless is None:
            self._confirm_cancel(run.lease)
            return
        for message in needless:
            withdraw(self._settings, message)

    def _give_back(self, job: Job, lease: Lease, *, costs_attempt: bool = False) -> None:
        if self._at_last(lambda session, now: leases.give_back(session, lease, now=now, costs_attempt=costs_attempt)):
            log.info("job given back", job=job.id, costs_attempt=costs_attempt)
            stopping.settle()
            self._publish([Message(job.id, job.queue)])
        else:
            self._confirm_cancel(lease)

    def _confirm_cancel(self, lease: Lease) -> None:
        if self._at_last(lambda session, now: leases.confirm_cancel(session, lease, now=now), frees=True):
            log.info("job canceled")

    def _at_last(self, step: Callable[[Session, datetime], T], *, frees: bool = False) -> T:
        """Take a last step of a job, once the database is there and has room for it: until then its lease is kept."""

        def once() -> T:
            with self._database.write(frees=frees) as session:
                return step(session, self._database.now())

        return Patience(stopping.check, limit_s=self._settings.max_outage_s, passes=_may_pass)(once)

    def _release_waiting(self) -> None:
        """Release, or fail, the jobs that waited for this one's medium."""
        with self._database.write() as session:
            released = jobs.release(session, now=self._database.now())
        self._publish(released)

    def _publish(self, messages: Iterable[Message]) -> None:
        for message in messages:
            try:
                send(self._app, message)
                with self._database.write() as session:
                    jobs.mark_published(session, message.job_id, now=self._database.now())
            except Exception as error:  # the reaper sends it again, and a second one does no harm
                log.warning("publish failed", waiting_job=message.job_id, error=type(error).__name__)
                return


def _name_in_logs(job: Job) -> None:
    """Have all lines that follow name the job, and what it is of."""
    structlog.contextvars.bind_contextvars(job=job.id, kind=job.kind, attempt=job.attempt)
    if job.media_id is not None:
        structlog.contextvars.bind_contextvars(medium=job.media_id)
    if job.parent_id is not None:
        structlog.contextvars.bind_contextvars(part_of=job.parent_id)
    if job.traceparent is not None:
        structlog.contextvars.bind_contextvars(trace_id=tracing.trace_id(job.traceparent))


def _done(run: Run) -> bool:
    """Do a job. False when its lease was lost. After a fault of this machine its error is raised a while later.

    Raises what the work does, and what ends a run that waits.
    """
    try:
        return _WORK[run.job.kind](run)
    except (OSError, UnforkedError) as error:
        if not lacks_room(error):
            until = time.monotonic() + FAULT_PAUSE_S
            while (left := until - time.monotonic()) > 0:
                run.keeper.check()
                time.sleep(min(left, ROOM_POLL_S))
        raise


def _may_pass(error: BaseException) -> bool:
    """Whether the records may take a step later: they are away, or their disk is full."""
    return is_outage(error) or is_disk_full(error)


def _worth_another_attempt(error: Exception) -> str | None:
    """Why a job that failed so is tried again; None when it would fail again."""
    if isinstance(error, CrashError):
        return "the job's process crashed"
    if lacks_room(error):
        return "no room was left for the job"
    if isinstance(error, tombstones.LateError):
        return "its files were stored too late to be kept"
    if isinstance(error, OSError):  # of no medium: those are of the method
        return "a disk or a shared folder failed"
    return "the database or the storage stays away" if is_outage(error) else None


_WORK: Mapping[str, Callable[[Run], bool]] = {
    JobKind.VECTORIZE: vectorize,
    JobKind.TRANSFER: render_or_split,
    JobKind.SWAP: render_or_split,
    PartKind.PART: draw_part,
    PartKind.JOIN: join,
}
