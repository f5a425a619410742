from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from service.catalog import Database, Lease, Progress, jobs, leases, parts, utc_now
from service.catalog.parts import NewPart
from service.settings import Settings
from tests.service.fixtures import add_media, claim, job_of
from tests.waiting import until
from worker import lease as lease_module
from worker import stopping
from worker.lease import CanceledError, LeaseKeeper, LeaseLostError
from worker.shared_moment import SharedMoment
from worker.stopping import StoppedError

QUICK = Settings(lease_s=0.6, heartbeat_s=0.1, progress_interval_s=0.05, max_outage_s=1)


def stopped_by(keeper: LeaseKeeper, seconds: float = 60) -> type[Exception]:
    """What the keeper says once the work has to stop."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            keeper.check()
        except (CanceledError, LeaseLostError) as verdict:
            return type(verdict)
        time.sleep(0.02)
    raise AssertionError("nothing stopped the work")


@pytest.fixture
def lease(database: Database) -> Lease:
    database.now = utc_now  # leases are kept in real time here
    return claim(database, add_media(database).job_id, lease_s=QUICK.lease_s)


def test_the_lease_lives_as_long_as_the_work(database: Database, lease: Lease) -> None:
    seen = set()
    with LeaseKeeper(database, lease, QUICK.model_copy(update={"lease_s": 60})) as keeper:
        end = time.monotonic() + 60
        while len(seen) < 4:  # it is renewed again and again
            seen.add(job_of(database, lease.job_id).lease_expires_at)
            assert time.monotonic() < end
            time.sleep(0.02)
        with database.write() as session:
            assert leases.reap(session, now=utc_now(), max_attempts=3) == []
        keeper.check()


def test_progress_reaches_the_record(database: Database, lease: Lease) -> None:
    with LeaseKeeper(database, lease, QUICK) as keeper:
        keeper.report(Progress("skin", 0.5, 10, 20))
        until(lambda: job_of(database, lease.job_id).stage is not None)
    job = job_of(database, lease.job_id)
    assert (job.stage, job.fraction, job.frames_done, job.frames_total) == ("skin", 0.5, 10, 20)


def test_progress_is_written_as_seldom_as_is_wanted_and_a_cancel_is_noticed_at_once(
    database: Database, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    tick, ticks = LeaseKeeper._tick, 0

    def counted(keeper: LeaseKeeper, progress: Progress | None) -> None:
        nonlocal ticks
        tick(keeper, progress)
        ticks += 1

    monkeypatch.setattr(LeaseKeeper, "_tick", counted)
    monkeypatch.setattr(lease_module, "_LOOK_S", 0.05)
    with LeaseKeeper(database, lease, QUICK.model_copy(update={"lease_s": 60, "progress_interval_s": 600})) as keeper:
        keeper.report(Progress("skin", 0.5, 10, 20))
        until(lambda: job_of(database, lease.job_id).stage is not None)
        keeper.report(Progress("skin", 0.6, 12, 20))
        seen = ticks
        until(lambda: ticks >= seen + 3)
        assert job_of(database, lease.job_id).frames_done == 10
        with database.write() as session:
            assert jobs.cancel(session, lease.job_id, now=utc_now())
        assert stopped_by(keeper) is CanceledError


def test_a_job_in_parts_is_told_of_as_seldom_as_is_wanted(database: Database, lease: Lease) -> None:
    with database.write() as session:
        wanted = [NewPart("vid_1", start, start + 10) for start in (0, 10)]
        made = parts.split(session, lease, wanted, now=utc_now(), timings={}) or []
    part = claim(database, made[0].job_id)
    with LeaseKeeper(database, part, QUICK.model_copy(update={"lease_s": 60, "progress_interval_s": 600})) as keeper:
        keeper.report(Progress("render", 0.5, 5, 10))
        keeper.flush()
    assert (job_of(database, part.job_id).fraction, job_of(database, lease.job_id).fraction) == (0.5, 0.0)
    with LeaseKeeper(database, part, QUICK.model_copy(update={"lease_s": 60, "progress_interval_s": 0})) as keeper:
        keeper.report(Progress("render", 0.6, 6, 10))
        keeper.flush()
    assert job_of(database, lease.job_id).fraction == 0.291


def test_a_job_shorter_than_a_tick_shows_its_frames(database: Database, lease: Lease) -> None:
    with LeaseKeeper(database, lease, Settings(progress_interval_s=60)) as keeper:
        keeper.report(Progress("render", 0.9, 8, 9))
        keeper.flush()
        with database.write() as session:
            assert leases.succeed(session, lease, now=utc_now(), timings={})
    job = job_of(database, lease.job_id)
    assert (job.stage, job.fraction, job.frames_done, job.frames_total) == ("render", 1.0, 9, 9)


def test_a_cancel_stops_the_work(database: Database, lease: Lease) -> None:
    with LeaseKeeper(database, lease, QUICK) as keeper:
        keeper.check()
        with database.write() as session:
            assert jobs.cancel(session, lease.job_id, now=utc_now())
        assert stopped_by(keeper) is CanceledError
        with pytest.raises(CanceledError):
            keeper.report(Progress("skin", 0.5, 10, 20))


def test_a_job_taken_away_stops_the_work(database: Database, lease: Lease) -> None:
    with LeaseKeeper(database, lease, QUICK) as keeper:
        with database.write() as session:
            assert jobs.revoke(session, lease.job_id, now=utc_now())
        assert stopped_by(keeper) is LeaseLostError


def test_a_database_that_is_away_for_too_long_stops_the_work(
    database: Database, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    def away() -> None:
        raise ConnectionError

    # much longer than the lease: the keeper counts from its last renewal, which was some time before
    with LeaseKeeper(database, lease, QUICK.model_copy(update={"max_outage_s": 4})) as keeper:
        began = time.monotonic()
        monkeypatch.setattr(database, "read", away)
        monkeypatch.setattr(database, "write", away)
        keeper.report(Progress("skin", 0.1, 1, 20))  # a slow database alone stops nothing
        assert stopped_by(keeper) is LeaseLostError
        assert time.monotonic() - began > QUICK.lease_s  # nobody can take the job over meanwhile


def test_a_worker_that_has_to_stop_gives_back_all_but_what_is_about_to_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = time.monotonic()
    assert stopping.may_go_on(now - 60, 0.0, grace_s=0)
    monkeypatch.setattr(stopping, "_asked", SharedMoment())
    monkeypatch.setattr(stopping, "time", SimpleNamespace(monotonic=lambda: now))
    stopping.ask()
    assert not stopping.may_go_on(now - 60, 0.5, grace_s=10)  # another minute
    assert stopping.may_go_on(now - 60, 0.9, grace_s=10)
    assert stopping.may_go_on(now - 1, 0.0, grace_s=10)  # its message is not sent yet
    assert not stopping.may_go_on(now - 1, 0.0, grace_s=0)
    assert stopping.may_go_on(now - 1, None, grace_s=10)  # a picture, perhaps
    assert not stopping.may_go_on(now - 1, None, grace_s=0)
    monkeypatch.setattr(stopping, "time", SimpleNamespace(monotonic=lambda: now + 3))
    assert not stopping.may_go_on(now - 1, 0.0, grace_s=10)
    assert stopping.may_go_on(now - 1, 0.5, grace_s=10)
    assert stopping.may_go_on(now - 1, None, grace_s=10)
    monkeypatch.setattr(stopping, "time", SimpleNamespace(monotonic=lambda: now + 6))
    assert not stopping.may_go_on(now - 1, None, grace_s=10)
    monkeypatch.setattr(stopping, "time", SimpleNamespace(monotonic=lambda: now + 11))
    assert not stopping.may_go_on(now - 60, 0.99, grace_s=10)


def test_a_job_is_given_back_before_its_work_has_noticed(
    database: Database, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    def give_back() -> None:
        with database.write() as session:
            assert leases.give_back(session, lease, now=utc_now())

    settings = QUICK.model_copy(update={"worker_stop_grace_s": 0})
    with LeaseKeeper(database, lease, settings, give_back) as keeper:
        keeper.check()
        monkeypatch.setattr(stopping, "_asked", SharedMoment())
        stopping.ask()
        until(lambda: job_of(database, lease.job_id).state == "queued")
        with pytest.raises(StoppedError):
            keeper.report(Progress("skin", 0.5, 10, 20))
    job = job_of(database, lease.job_id)
    assert (job.state, job.attempt, job.lease_token, job.published_at) == ("queued", 1, None, None)
