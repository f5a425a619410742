"""A database that does what it is asked to, and whose answer is lost."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from service.catalog import Database, Job, JobKind, JobState, jobs, leases, media, tombstones
from tests.service.fixtures import add_media, add_transfer, job_of
from tests.service.fixtures import claim as claim_job
from worker import runner as runner_module
from worker.failures import LostAssetsError
from worker.run import Run
from worker.runner import Runner


def away() -> OperationalError:
    error = sqlite3.OperationalError("disk I/O error")
    error.sqlite_errorcode = sqlite3.SQLITE_IOERR
    return OperationalError("COMMIT", None, error)


def loses_an_answer(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next transaction is committed, and its writer told that the database is away."""
    write = database.write

    @contextmanager
    def once(**named: bool) -> Iterator[Session]:
        monkeypatch.setattr(database, "write", write)
        with write(**named) as session:
            yield session
        raise away()

    monkeypatch.setattr(database, "write", once)


def state_of(database: Database, job_id: str) -> tuple[str, int]:
    job = job_of(database, job_id)
    return job.state, job.attempt


def test_a_job_whose_claim_was_not_answered_is_done_all_the_same(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = runner._database
    medium = add_media(database)

    def work(run: Run) -> bool:
        with database.write() as session:
            return leases.succeed(session, run.lease, now=database.now(), timings={})

    monkeypatch.setattr(runner_module, "_WORK", {JobKind.VECTORIZE: work})
    loses_an_answer(database, monkeypatch)
    runner.run(medium.job_id)
    assert state_of(database, medium.job_id) == (JobState.SUCCEEDED, 1)


def test_a_claim_of_another_job_that_was_not_answered_takes_one_job(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = runner._database
    add_media(database, owner="key_a")
    with database.write() as session:
        session.query(Job).one().started_at = database.now()  # this key was served before
    named, other = add_media(database, owner="key_a"), add_media(database, owner="key_b")
    done = list[str]()

    def work(run: Run) -> bool:
        done.append(run.job.id)
        with database.read() as session:
            assert session.query(Job).filter(Job.lease_token.is_not(None)).count() == 1
        with database.write() as session:
            return leases.succeed(session, run.lease, now=database.now(), timings={})

    monkeypatch.setattr(runner_module, "_WORK", {JobKind.VECTORIZE: work})
    loses_an_answer(database, monkeypatch)
    runner.run(named.job_id)
    assert done == [other.job_id]
    assert state_of(database, named.job_id) == (JobState.QUEUED, 1)


def test_a_job_whose_files_were_stored_too_late_is_tried_again(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    database = runner._database
    medium = add_media(database)

    def work(run: Run) -> bool:
        raise tombstones.LateError(run.job.id)

    monkeypatch.setattr(runner_module, "_WORK", {JobKind.VECTORIZE: work})
    reached = []
    for _ in range(3):
        runner.run(medium.job_id)
        reached.append(state_of(database, medium.job_id))
    assert reached == [(JobState.QUEUED, 2), (JobState.QUEUED, 3), (JobState.FAILED, 3)]


@pytest.mark.parametrize("is_done", [True, False])
def test_an_asset_is_made_again_though_the_database_is_away_for_a_moment(
    runner: Runner, monkeypatch: pytest.MonkeyPatch, is_done: bool
) -> None:
    database = runner._database
    medium = add_media(database)
    lease = claim_job(database, medium.job_id)
    with database.write() as session:
        assert leases.succeed(session, lease, now=database.now(), timings={})
        session.get_one(media.Media, medium.id).state = "ready"
    job_id = add_transfer(database, medium, medium)
    with database.write() as session:
        jobs.release(session, now=database.now())
    make_again, calls = media.make_again, list[str]()

    def fails_first(session: Session, *given: Any, **named: Any) -> Any:
        calls.append("made again")
        if len(calls) == 1 and not is_done:
            raise away()
        return make_again(session, *given, **named)

    def work(_: Run) -> bool:
        if is_done:
            loses_an_answer(database, monkeypatch)
        raise LostAssetsError({medium.id: None})

    monkeypatch.setattr(media, "make_again", fails_first)
    monkeypatch.setattr(runner_module, "_WORK", {JobKind.TRANSFER: work})
    runner.run(job_id)
    assert len(calls) == 2
    with database.read() as session:
        found, job = session.get_one(media.Media, medium.id), session.get_one(Job, job_id)
    assert (found.state, job.state, job.waiting, job.attempt) == ("vectorizing", "queued", True, 1)
