"""A worker whose own disk fails, or which cannot fork, ends no job for that, and outruns no worker that is well."""

from __future__ import annotations

import errno
import sqlite3
import time
from pathlib import Path

import pytest
from sqlalchemy.exc import OperationalError

from service.catalog import Database, Job, JobKind, JobState, Message, leases, workers
from service.queue import make_folders
from service.settings import Settings
from service.spool import Spool
from tests.service.fixtures import add_media, job_of
from tests.waiting import until
from worker import runner as runner_module
from worker.heartbeat import Heartbeat
from worker.run import Run
from worker.runner import Runner
from worker.sandbox import UnforkedError

PAUSE_S = 0.2


@pytest.fixture
def runner(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> Runner:
    monkeypatch.setattr(runner_module, "ROOM_WAIT_S", 0.05)
    monkeypatch.setattr(runner_module, "FAULT_PAUSE_S", PAUSE_S, raising=False)
    monkeypatch.setattr(runner_module, "_WORK", {JobKind.VECTORIZE: begins_and_ends})
    return runner


def begins_and_ends(run: Run) -> bool:
    run.draft_folder()
    with run.database.write() as session:
        return leases.succeed(session, run.lease, now=run.database.now(), timings={})


def test_a_worker_that_cannot_write_begins_no_job_until_it_can(runner: Runner, settings: Settings) -> None:
    database, away = runner._database, settings.folder / "away"
    medium = add_media(database)
    settings.spool_folder.rename(away)
    runner.run(medium.job_id)
    job = job_of(database, medium.job_id)
    assert (job.state, job.attempt, job.stage, job.published_at) == (JobState.QUEUED, 1, None, None)
    away.rename(settings.spool_folder)
    runner.run(medium.job_id)
    assert job_of(database, medium.job_id).state == JobState.SUCCEEDED


@pytest.mark.parametrize(
    ("error", "problem"),
    [
        (OSError(errno.EROFS, "Read-only file system", "/srv/secret"), "unavailable"),
        (OSError(errno.EIO, "Input/output error", "/srv/secret"), "unavailable"),
        (UnforkedError("could not fork"), "worker-crashed"),
    ],
)
def test_a_job_that_failed_for_its_worker_is_tried_again_after_a_pause(
    runner: Runner, monkeypatch: pytest.MonkeyPatch, error: Exception, problem: str
) -> None:
    database = runner._database
    medium = add_media(database)

    def work(_: Run) -> bool:
        raise error

    monkeypatch.setattr(runner_module, "_WORK", {JobKind.VECTORIZE: work})
    reached, began = [], time.monotonic()
    for _ in range(3):
        runner.run(medium.job_id)
        job = job_of(database, medium.job_id)
        reached.append((job.state, job.attempt))
    assert reached == [(JobState.QUEUED, 2), (JobState.QUEUED, 3), (JobState.FAILED, 3)]
    assert time.monotonic() - began > 3 * PAUSE_S
    assert job.error is not None
    assert job.error["type"] == problem
    assert "secret" not in str(job.error)


def test_what_waited_for_a_job_is_left_to_the_reaper_where_the_disk_of_the_records_is_full(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    medium = add_media(runner._database)
    full = sqlite3.OperationalError("database or disk is full")
    full.sqlite_errorcode = sqlite3.SQLITE_FULL

    def release(*_: object, **__: object) -> list[Message]:
        raise OperationalError("UPDATE jobs", None, full)

    monkeypatch.setattr(runner_module.jobs, "release", release)
    runner.run(medium.job_id)  # no error of the task, whose job has ended well
    assert job_of(runner._database, medium.job_id).state == JobState.SUCCEEDED


def test_a_job_that_is_canceled_ends_the_pause(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    database = runner._database
    medium = add_media(database)

    def work(run: Run) -> bool:
        with database.write() as session:
            session.get_one(Job, run.job.id).state = JobState.CANCELING
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(runner_module, "FAULT_PAUSE_S", 600.0)
    monkeypatch.setattr(runner_module, "_WORK", {JobKind.VECTORIZE: work})
    runner.run(medium.job_id)
    assert job_of(database, medium.job_id).state == JobState.CANCELED


def test_a_worker_says_that_it_cannot_write_and_when_it_can(database: Database, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", database_url=database.url, heartbeat_s=0.05)
    make_folders(settings)
    heartbeat, away = Heartbeat(settings), tmp_path / "away"

    def lacking() -> list[str | None]:
        with database.read() as session:
            return workers.lacking(session, since=database.now().replace(year=2000))

    heartbeat.start()
    until(lambda: lacking() == [None])
    settings.spool_folder.rename(away)
    until(lambda: lacking() == [workers.DISK])
    away.rename(settings.spool_folder)
    until(lambda: lacking() == [None])
    heartbeat.stop()


def test_a_disk_is_tried_without_a_trace(settings: Settings) -> None:
    Spool(settings.spool_folder).check_drafts()
    assert list(settings.spool_folder.iterdir()) == []
