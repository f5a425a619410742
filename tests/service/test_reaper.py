from __future__ import annotations

import errno
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from psycopg.errors import DeadlockDetected
from sqlalchemy import Engine, event, text
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from service import blobs, reaper
from service.api import Services, make_services
from service.catalog import (
    Database,
    Delivery,
    Job,
    Media,
    collecting,
    idempotency,
    jobs,
    leases,
    media,
    results,
    sweep,
    tombstones,
    webhooks,
    workers,
)
from service.catalog.models import Collection, IdempotentRequest, Worker
from service.queue import RENDER, VECTORIZE
from service.settings import Settings
from tests.service.catalog.test_parts import parted
from tests.service.fixtures import (
    FakeClock,
    add_media,
    add_transfer,
    announce,
    claim,
    job_of,
    make_ready,
    make_results,
    make_tables,
)
from tests.service.queue.test_broker import messages, take
from tests.service.servers import fresh_database
from tests.waiting import until

HOUR = 3600.0


@pytest.fixture
def services(tmp_path: Path, clock: FakeClock) -> Iterator[Services]:
    """An API's parts without its server; rounds are run by the tests."""
    settings = Settings(
        data_dir=tmp_path / "data", result_ttl_s=HOUR, media_ttl_s=10 * HOUR, job_ttl_s=20 * HOUR, max_queued_s=HOUR
    )
    make_tables(settings.database)
    services = make_services(settings, clock=clock)
    services.publisher.start()
    yield services
    services.publisher.stop()
    services.database.close()


@pytest.fixture
def on_server(tmp_path: Path, postgres_url: str, postgres_tables: str, clock: FakeClock) -> Iterator[Services]:
    """The same with PostgreSQL, where others may keep rows; the reaper waits a second for them."""
    with fresh_database(postgres_url, postgres_tables) as url:
        settings = Settings(data_dir=tmp_path / "data", database_url=url)
        made, own = make_services(settings, clock=clock), Database(url, clock=clock, lock_wait_s=1)
        deleting = blobs.Blobs(own, made.storage)
        impatient = reaper.Reaper(settings, own, made.storage, made.room, deleting, made.publisher)
        yield replace(made, reaper=impatient)
        own.close()
        made.close()


def published(services: Services, job_id: str) -> bool:
    """True once the job's message is out; the publisher works in a thread of its own."""

    def is_out() -> bool:
        with services.database.read() as session:
            return session.get_one(Job, job_id).published_at is not None

    return until(is_out)


def test_a_job_whose_message_was_never_sent_is_published(services: Services, clock: FakeClock) -> None:
    medium = add_media(services.database)
    services.reaper.round()
    assert messages(services.settings) == []  # younger than the publisher may take
    clock.forward(11)
    services.reaper.round()
    assert published(services, medium.job_id)
    assert take(services.settings, VECTORIZE) == [medium.job_id]


def test_everything_queued_is_published_again_when_the_broker_lost_messages(
    services: Services, clock: FakeClock
) -> None:
    ids = [add_media(services.database).job_id for _ in range(5)]
    clock.forward(11)
    services.reaper.round()
    assert all(published(services, job_id) for job_id in ids)
    clock.forward(11)
    services.reaper.round()
    assert len(messages(services.settings)) == 5  # nothing was lost, nothing is sent twice
    for path in messages(services.settings)[:2]:
        path.unlink()
    clock.forward(11)
    services.reaper.round()
    assert len(messages(services.settings)) == 3  # it may have been on its way to a worker
    services.reaper.round()
    until(lambda: len(messages(services.settings)) == 5)
    services.publisher.stop()
    assert set(take(services.settings, VECTORIZE)) == set(ids)


def claimed_after_a_round(services: Services) -> str:
    """The id of a job whose worker is gone; the reaper knows that the database answered just before."""
    services.reaper.round()
    job_id = add_media(services.database).job_id
    claim(services.database, job_id)
    return job_id


def is_full(statement: str) -> OperationalError:
    full = sqlite3.OperationalError("database or disk is full")
    full.sqlite_errorcode = sqlite3.SQLITE_FULL
    return OperationalError(statement, None, full)


@contextmanager
def full_disk() -> Iterator[None]:
    """The disk of the database takes no more of what its jobs become."""

    def refuse(_connection: object, _cursor: object, statement: str, *_more: object) -> None:
        if statement.startswith("UPDATE jobs"):
            raise is_full(statement)

    event.listen(Engine, "before_cursor_execute", refuse)
    try:
        yield
    finally:
        event.remove(Engine, "before_cursor_execute", refuse)


def test_a_full_disk_is_said_once_and_keeps_no_worker_from_its_job(
    services: Services, clock: FakeClock, machine: SimpleNamespace, caplog: pytest.LogCaptureFixture
) -> None:
    job_id = claimed_after_a_round(services)
    caplog.clear()
    with full_disk():
        for _ in range(2):
            clock.forward(10)
            machine.steady_s += 10
            services.reaper.round()
    said = [record for record in caplog.records if record.name == "service.reaper"]
    assert [(one.levelname, one.message, one.exc_info) for one in said] == [
        ("WARNING", "the disk is full: steps of the reaper wait for room", None)
    ]
    clock.forward(11)  # it could not renew its lease
    machine.steady_s += 11
    services.reaper.round()
    assert states(services, job_id) == [("running", 1)]
    assert rounds_until_queued(services, clock, machine, job_id) <= 20


@pytest.mark.parametrize("what", ["forget", "reserve"])
def test_what_else_has_no_room_puts_no_lost_worker_off(
    services: Services, clock: FakeClock, machine: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """As the reserve, where the quota of a user is used up, round after round: workers renew their leases."""

    def forget() -> None:
        raise is_full("PRAGMA wal_checkpoint(TRUNCATE)")

    def posix_fallocate(*_what: int) -> None:
        raise OSError(errno.EDQUOT, "Disk quota exceeded")

    if what == "forget":
        monkeypatch.setattr(services.background, "forget", forget)
    else:
        monkeypatch.setattr(os, "posix_fallocate", posix_fallocate)
    job_id = claimed_after_a_round(services)
    assert rounds_until_queued(services, clock, machine, job_id) <= 40


def test_a_lapsed_job_is_queued_and_published_again(services: Services, clock: FakeClock) -> None:
    medium = add_media(services.database)
    claim(services.database, medium.job_id)
    clock.forward(31)
    services.reaper.round()
    assert published(services, medium.job_id)
    assert take(services.settings, VECTORIZE) == [medium.job_id]


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The steady clock of the machine that the reaper is on, which a test moves."""
    machine = SimpleNamespace(steady_s=1000.0)
    monkeypatch.setattr(reaper, "time", SimpleNamespace(monotonic=lambda: machine.steady_s))
    return machine


def rounds_until_queued(services: Services, clock: FakeClock, machine: SimpleNamespace, job_id: str) -> float:
    """Seconds until a job is queued whose worker is gone, with a round every ten."""
    for passed in range(10, 100, 10):
        clock.forward(10)
        machine.steady_s += 10
        services.reaper.round()
        with services.database.read() as session:
            if session.get_one(Job, job_id).state == "queued":
                return passed
    raise AssertionError("it is never queued")


def test_a_job_of_a_lost_worker_is_queued_soon(services: Services, clock: FakeClock, machine: SimpleNamespace) -> None:
    job_id = claimed_after_a_round(services)
    assert rounds_until_queued(services, clock, machine, job_id) <= 40


def test_a_long_round_puts_no_lost_worker_off(
    services: Services, clock: FakeClock, machine: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    def expire() -> None:
        clock.forward(60)
        machine.steady_s += 60

    monkeypatch.setattr(services.reaper, "expire", expire)
    job_id = claimed_after_a_round(services)
    assert rounds_until_queued(services, clock, machine, job_id) <= 20  # the first is held up after its look


def test_a_step_that_fails_while_the_database_answers_puts_no_lost_worker_off(
    services: Services, clock: FakeClock, machine: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    def expire() -> None:
        raise OperationalError("DELETE", None, DeadlockDetected("deadlock detected"))

    monkeypatch.setattr(services.reaper, "expire", expire)
    job_id = claimed_after_a_round(services)
    assert rounds_until_queued(services, clock, machine, job_id) <= 40


def test_workers_have_time_after_a_database_that_went_away_during_a_round(
    services: Services, clock: FakeClock, machine: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It answers again by the round's end; for how long it was away is not known."""

    def expire() -> None:
        clock.forward(31)
        machine.steady_s += 31
        raise OperationalError("DELETE", None, ConnectionError(), connection_invalidated=True)

    medium = add_media(services.database)
    claim(services.database, medium.job_id)
    with monkeypatch.context() as patch:
        patch.setattr(services.reaper, "expire", expire)
        services.reaper.round()
    services.reaper.round()
    assert states(services, medium.job_id) == [("running", 1)]
    assert rounds_until_queued(services, clock, machine, medium.job_id) <= 30


def test_a_medium_that_cannot_be_removed_keeps_no_others(
    services: Services, clock: FakeClock, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stuck, late = (add_media(services.database).id for _ in range(2))
    for medium_id in (stuck, late):
        make_ready(services, medium_id)
    delete = media.delete

    def fails(session: Session, medium: Media, **how: Any) -> list[str]:
        if medium.id == stuck:
            raise ValueError("there is more of it than fits")
        return delete(session, medium, **how)

    monkeypatch.setattr(media, "delete", fails)
    clock.forward(1001)
    services.reaper.round()
    with services.database.read() as session:
        assert [one.id for one in session.query(Media)] == [stuck]
    assert "a medium past its retention could not be removed" in caplog.text


def test_a_medium_past_its_retention_goes_on_a_full_disk_with_what_is_kept_for_that(
    services: Services, clock: FakeClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_ready(services, add_media(services.database).id)
    given: list[str] = []
    monkeypatch.setattr(services.background, "_before_freeing", lambda: given.append("a part"))
    delete = media.delete

    def needs_room(session: Session, medium: Media, **how: Any) -> list[str]:
        if not given:
            raise is_full("DELETE")
        return delete(session, medium, **how)

    monkeypatch.setattr(media, "delete", needs_room)
    clock.forward(1001)
    services.reaper.expire()
    with services.database.read() as session:
        assert session.query(Media).all() == []


def states(services: Services, *job_ids: str) -> list[tuple[str, int]]:
    with services.database.read() as session:
        return [(job.state, job.attempt) for job in (session.get_one(Job, job_id) for job_id in job_ids)]


def test_a_job_that_another_transaction_keeps_holds_up_no_others(on_server: Services, clock: FakeClock) -> None:
    """As that of a worker does whose machine has lost its power in the middle of it."""
    kept, lost = (add_media(on_server.database).job_id for _ in range(2))
    for job_id in (kept, lost):
        claim(on_server.database, job_id)
    whole, (part, _) = parted(on_server.database, 2)
    claim(on_server.database, part)
    ready = add_media(on_server.database)
    make_ready(on_server, ready.id)
    held, waiting = (add_transfer(on_server.database, ready, ready) for _ in range(2))
    clock.forward(31)
    with on_server.background.write() as session:
        for job_id in (kept, whole, held):
            session.get_one(Job, job_id, with_for_update=True)
        on_server.reaper.round()
        assert states(on_server, kept, part, lost) == [("running", 1), ("running", 1), ("queued", 2)]
        with on_server.database.read() as other:
            assert [other.get_one(Job, job_id).waiting for job_id in (held, waiting)] == [True, False]
    on_server.reaper.round()
    assert states(on_server, kept, part, lost) == [("queued", 2), ("queued", 2), ("queued", 2)]


def test_lost_jobs_do_not_wait_because_another_step_waits_for_a_row(
    on_server: Services, clock: FakeClock, machine: SimpleNamespace, caplog: pytest.LogCaptureFixture
) -> None:
    medium = add_media(on_server.database)
    make_ready(on_server, medium.id)
    job_id = add_media(on_server.database).job_id
    claim(on_server.database, job_id)
    with on_server.background.write() as session:
        session.get_one(Media, medium.id).expires_at = clock()
    for _ in range(4):
        clock.forward(10)
        machine.steady_s += 10
        with on_server.background.write() as session:
            session.get_one(Media, medium.id, with_for_update=True)
            on_server.reaper.round()
    assert states(on_server, job_id) == [("queued", 2)]
    assert caplog.text.count("others keep what the reaper waits for") == 4


def test_workers_that_cannot_renew_because_of_a_lock_have_time_afterwards(
    on_server: Services, clock: FakeClock, machine: SimpleNamespace
) -> None:
    """While a table is changed nobody else has it."""
    job_id = add_media(on_server.database).job_id
    claim(on_server.database, job_id)
    clock.forward(31)
    with on_server.background.write() as session:
        session.execute(text("LOCK TABLE jobs IN ACCESS EXCLUSIVE MODE"))
        on_server.reaper.round()
    on_server.reaper.round()
    assert states(on_server, job_id) == [("running", 1)]
    assert rounds_until_queued(on_server, clock, machine, job_id) <= 30


@pytest.mark.parametrize("steady_s", [10, 600], ids=["the machine sleeps", "its processes are paused"])
def test_workers_that_were_held_up_with_the_reaper_keep_their_jobs(
    services: Services, clock: FakeClock, machine: SimpleNamespace, steady_s: float
) -> None:
    medium = add_media(services.database)
    lease = claim(services.database, medium.job_id)
    services.reaper.round()
    clock.forward(600)
    machine.steady_s += steady_s
    services.reaper.round()
    clock.forward(5)
    machine.steady_s += 5
    with services.database.write() as session:
        assert leases.renew(session, lease, now=services.database.now(), lease_s=30)
    assert 30 <= rounds_until_queued(services, clock, machine, medium.job_id) <= 40  # and no longer when it is lost


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_a_clock_that_is_set_neither_takes_jobs_nor_keeps_them(
    services: Services, clock: FakeClock, machine: SimpleNamespace, step_s: float
) -> None:
    medium = add_media(services.database)
    lease = claim(services.database, medium.job_id)
    services.reaper.round()
    clock.forward(step_s)
    services.reaper.round()
    with services.database.read() as session:
        assert leases.held_state(session, lease)
    assert rounds_until_queued(services, clock, machine, medium.job_id) <= 40


def test_what_was_dated_by_a_clock_that_is_set_back_does_not_wait_for_it(
    services: Services, clock: FakeClock, machine: SimpleNamespace
) -> None:
    database, year_s = services.database, 365 * 24 * HOUR
    queued, sent, over = (add_media(database).job_id for _ in range(3))
    urls = [f"https://receiver.example/{name}" for name in ("new", "tried")]
    with services.background.write() as session:
        job = session.get_one(Job, over)
        job.state = "failed"
        session.get_one(Job, sent).published_at = clock()
        for url in urls:
            webhooks.announce(session, job, url, now=clock())
        tombstones.expect(session, "asset/x", now=clock(), within_s=900)
        claimed = idempotency.Claim("", "key", "token")
        idempotency.begin(session, claimed, now=clock(), lock_s=idempotency.LOCK_S, ttl_s=HOUR)
        collecting.begin(session, now=clock(), unless_since=clock())
        session.add(Worker(id="lost", started_at=clock(), seen_at=clock()))
    with services.background.write() as session:
        tried = session.query(Delivery).filter_by(url=urls[1]).one()
        attempt = webhooks.claim(session, tried.id, now=clock(), lease_s=30)
        assert attempt is not None
        assert webhooks.missed(session, attempt, now=clock(), retry_s=300, status=500, error="x")
    services.reaper.round()
    clock.forward(-year_s)
    services.reaper.revive()

    now = clock()
    with database.read() as session:
        assert {one.job_id for one in sweep.unpublished(session, before=now + timedelta(seconds=1))} >= {queued}
        assert {one.job_id for one in sweep.published(session, VECTORIZE, before=now + timedelta(seconds=1))} == {sent}
        waits = {one.url: (one.next_at - now).total_seconds() for one in session.query(Delivery) if one.next_at}
        assert waits == {urls[0]: 0, urls[1]: 300}
        assert tombstones.due(session, now=now + timedelta(hours=3), limit=9) == ["asset/x"]
        assert session.query(IdempotentRequest).one().locked_until <= now + timedelta(seconds=idempotency.LOCK_S)
        assert session.query(Collection).one().began_at == now
        assert workers.heard_of(session, since=now + timedelta(seconds=1)) == 0


def test_a_job_that_missed_its_medium_becoming_ready_is_let_go(services: Services) -> None:
    medium = add_media(services.database)
    job_id = add_transfer(services.database, medium, medium)
    lease = claim(services.database, medium.job_id)
    with services.background.write() as session:
        asset = media.Asset("asset/x", 1, {}, [], [])
        announce(session, "asset/x")
        media.finish(session, lease, asset, now=services.database.now(), timings={})
    services.reaper.round()
    assert published(services, job_id)
    assert take(services.settings, RENDER) == [job_id]


def test_jobs_nobody_takes_expire(services: Services, clock: FakeClock) -> None:
    medium = add_media(services.database)
    clock.forward(HOUR + 1)
    services.reaper.round()
    job = job_of(services.database, medium.job_id)
    assert job.state == "expired"


def test_results_then_media_then_jobs_go_when_their_time_is_over(services: Services, clock: FakeClock) -> None:
    medium = add_media(services.database)
    draft = services.storage.spool.draft()
    draft.write_bytes(b"source")
    services.storage.put(draft, medium.source_key)
    make_ready(services, medium.id)
    job_id = add_transfer(services.database, medium, medium)
    with services.background.write() as session:
        jobs.release(session, now=clock())
    (result_id,) = make_results(services, job_id, [b"result"])

    def blobs() -> int:
        return len(list(services.storage.entries()))

    clock.forward(999)
    services.reaper.round()
    assert blobs() == 3
    clock.forward(2)  # make_results keeps for 1000 s
    services.reaper.round()
    assert blobs() == 0  # add_media keeps for 1000 s as well
    with services.database.read() as session:
        assert media.get(session, medium.id) is None
        assert results.get(session, result_id) is None
        assert session.get(Job, job_id) is not None
    clock.forward(20 * HOUR)
    services.reaper.round()
    with services.database.read() as session:
        assert session.query(Job).count() == 0


def test_media_in_use_outlive_their_time(services: Services, clock: FakeClock) -> None:
    medium = add_media(services.database)
    claim(services.database, medium.job_id, lease_s=5000)
    clock.forward(1001)
    services.reaper.round()
    with services.database.read() as session:
        assert media.get(session, medium.id) is not None


def test_all_that_is_due_goes_at_once(services: Services, clock: FakeClock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep, "BATCH", 2)
    monkeypatch.setattr(blobs, "_BATCH", 2)
    for _ in range(5):
        make_ready(services, add_media(services.database).id)
    clock.forward(50 * HOUR)
    assert services.reaper.clear() == 10  # of each medium two
    assert list(services.storage.entries()) == []
    with services.database.read() as session:
        assert session.query(Job).count() == 0


def test_drafts_nobody_writes_any_more_are_removed(services: Services) -> None:
    draft = services.storage.spool.draft()
    draft.write_bytes(b"x")
    services.reaper.round()
    assert draft.exists()
    os.utime(draft, (time.time() - 25 * HOUR,) * 2)
    services.reaper.round()
    assert not draft.exists()


def test_drafts_of_a_killed_worker_go_with_its_lease(services: Services, clock: FakeClock) -> None:
    """They hold parts of a face, and must not outlive a deletion."""
    medium = add_media(services.database)
    claim(services.database, medium.job_id, lease_s=30)
    draft = services.storage.spool.draft(".pvg", job_id=medium.job_id)
    partial = draft.with_name(f".{draft.name}.abc")  # as the method names what it writes
    other = services.storage.spool.draft()
    for path in (draft, partial, other):
        path.write_bytes(b"x")
    services.reaper.expire()
    assert all(path.exists() for path in (draft, partial, other))
    clock.forward(31)
    services.reaper.round()
    assert [path.exists() for path in (draft, partial, other)] == [False, False, True]


def test_a_broker_that_is_away_fails_no_round(tmp_path: Path, clock: FakeClock) -> None:
    settings = Settings(data_dir=tmp_path, broker_url="redis://127.0.0.1:1/0")
    make_tables(settings.database)
    services = make_services(settings, clock=clock)
    services.publisher.start()
    medium = add_media(services.database)
    clock.forward(11)
    services.reaper.round()
    services.publisher.stop()
    with services.database.read() as session:
        job = session.get(Job, medium.job_id)
    services.database.close()
    assert job is not None
    assert (job.state, job.published_at) == ("queued", None)
