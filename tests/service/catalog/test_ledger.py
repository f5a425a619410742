"""What owners have had done, by month: each thing once, whatever becomes of it, and whoever else counts meanwhile."""

from __future__ import annotations

import multiprocessing
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from service.catalog import (
    Asset,
    Database,
    Job,
    JobKind,
    Lease,
    LookParams,
    Media,
    NewLook,
    Output,
    RenderRequest,
    jobs,
    keys,
    leases,
    ledger,
    media,
    results,
    sweep,
)
from service.catalog.ledger import Month
from service.catalog.models import MonthlyUsage
from tests.service.catalog.test_parts import draw_all, publish, split
from tests.service.fixtures import FakeClock, add_media, announce, claim

PROBLEM = {"type": "no-face", "title": "t", "detail": "d"}
INFO = {"frame_count": 240, "duration_s": 8.008}
NOVEMBER = datetime(2026, 11, 30, 23, 59, 59, 999_999, tzinfo=UTC)


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock(datetime(2026, 11, 15, tzinfo=UTC))


def ready(database: Database, owner: str = "") -> Media:
    """A clip that is vectorised."""
    medium = add_media(database, owner=owner)
    lease = claim(database, medium.job_id)
    asset = Asset(f"asset/{medium.id}", 1, INFO, [], [])
    with database.write() as session:
        announce(session, asset.key)
        media.finish(session, lease, asset, now=database.now(), timings={})
    return medium


def ask(database: Database, medium: Media, *, looks: int = 1) -> str:
    """A transfer of the medium's owner; its id."""
    wanted = [NewLook(medium.id, medium.id, LookParams(seed=seed)) for seed in range(looks)]
    with database.write() as session:
        made = jobs.create(
            session,
            JobKind.TRANSFER,
            request=RenderRequest(),
            now=database.now(),
            outputs=wanted,
            owner=medium.owner,
            ready=True,
        )
    return made.id


def draw(database: Database, lease: Lease, *, looks: int = 1) -> bool:
    outputs = [
        Output(f"res_{lease.token}-{k}", k, f"result/{lease.token}-{k}", "0" * 64, 1, "video/mp4", "a.mp4")
        for k in range(looks)
    ]
    with database.write() as session:
        announce(session, *(output.key for output in outputs))
        return results.publish(session, lease, outputs, now=database.now(), timings={}, ttl_s=100)


def months(database: Database, owner: str = "") -> list[Month]:
    with database.read() as session:
        return ledger.months(session, owner, now=database.now())


def this_month(database: Database, owner: str = "") -> Month:
    return months(database, owner)[0]


def test_a_job_counts_once_with_each_of_its_looks(database: Database) -> None:
    medium = ready(database)
    assert this_month(database) == Month("2026-11", {"succeeded": 1}, 0, 0, 0.0, 1, 10)
    job_id = ask(database, medium, looks=3)
    assert this_month(database).jobs == {"succeeded": 1}
    lease = claim(database, job_id)
    assert draw(database, lease, looks=3)
    assert not draw(database, lease, looks=3)  # as who had no answer does
    assert this_month(database) == Month("2026-11", {"succeeded": 2}, 3, 720, 24.024, 1, 10)


def test_what_did_not_succeed_made_no_looks(database: Database, clock: FakeClock) -> None:
    medium = ready(database)
    failed, canceled, expired, revoked = (ask(database, medium) for _ in range(4))
    lease = claim(database, failed)
    claim(database, revoked)
    with database.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=clock(), timings={})
        assert not leases.fail(session, lease, PROBLEM, now=clock(), timings={})
        assert jobs.cancel(session, canceled, now=clock())
        assert not jobs.cancel(session, canceled, now=clock())
        assert jobs.revoke(session, revoked, now=clock())
    clock.forward(100)
    with database.write() as session:
        jobs.expire(session, before=clock(), now=clock())
        assert jobs.get(session, expired) is not None
    ended = {"succeeded": 1, "failed": 1, "canceled": 2, "expired": 1}
    assert this_month(database) == Month("2026-11", ended, 0, 0, 0.0, 1, 10)


def test_a_job_that_is_tried_again_counts_at_its_end(database: Database, clock: FakeClock) -> None:
    medium = ready(database)
    job_id = ask(database, medium)
    lost = claim(database, job_id)
    clock.forward(60)
    with database.write() as session:
        assert [one.job_id for one in leases.reap(session, now=clock(), max_attempts=3)] == [job_id]
    assert this_month(database).jobs == {"succeeded": 1}
    given_back = claim(database, job_id)
    with database.write() as session:
        assert leases.give_back(session, given_back, now=clock())
    assert draw(database, claim(database, job_id))
    assert not draw(database, lost)
    assert (this_month(database).jobs, this_month(database).looks) == ({"succeeded": 2}, 1)


def test_a_job_in_parts_counts_as_one(database: Database) -> None:
    medium = ready(database, "key_a")
    join = draw_all(database, split(database, ask(database, medium), 3))
    assert this_month(database, "key_a").jobs == {"succeeded": 1}
    assert publish(database, claim(database, join))
    assert this_month(database, "key_a") == Month("2026-11", {"succeeded": 2}, 1, 240, 8.008, 1, 10)


def test_a_job_in_parts_that_fails_or_is_canceled_counts_as_one(database: Database, clock: FakeClock) -> None:
    medium = ready(database)
    failing, canceled = ask(database, medium), ask(database, medium)
    first, *_ = split(database, failing, 3)
    split(database, canceled, 3)
    lease = claim(database, first)
    with database.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=clock(), timings={})
        assert jobs.cancel(session, canceled, now=clock())
    assert this_month(database).jobs == {"succeeded": 1, "failed": 1, "canceled": 1}
    assert this_month(database).looks == 0


def test_nothing_that_is_removed_is_counted_less(database: Database, clock: FakeClock) -> None:
    medium = ready(database)
    first, second = ask(database, medium), ask(database, medium)
    for job_id in (first, second):
        assert draw(database, claim(database, job_id))
    before = this_month(database)
    assert (before.jobs, before.looks) == ({"succeeded": 3}, 2)
    with database.write() as session:
        sweep.delete_job(session, first, now=clock())
    with database.write() as session:
        found = media.get(session, medium.id)
        assert found is not None
        media.delete(session, found, now=clock())
    clock.forward(86_400)
    with database.write() as session:
        assert sweep.expire_jobs(session, before=clock()) == 2
        assert session.scalars(select(Job.id)).all() == []
    assert this_month(database) == before


def test_what_is_not_committed_is_not_counted(database: Database, clock: FakeClock) -> None:
    medium = ready(database)
    job_id = ask(database, medium)

    def give_up(session: Session) -> None:
        assert jobs.revoke(session, job_id, now=clock())
        raise RuntimeError

    with pytest.raises(RuntimeError), database.write() as session:
        give_up(session)
    assert this_month(database).jobs == {"succeeded": 1}


def test_a_month_is_one_of_utc_and_of_the_end(database: Database, clock: FakeClock) -> None:
    clock.time = NOVEMBER - timedelta(seconds=10)
    medium = ready(database)
    early, late = ask(database, medium), ask(database, medium)
    leases_ = claim(database, early), claim(database, late)
    clock.time = NOVEMBER
    assert draw(database, leases_[0])
    clock.forward(1e-6)
    assert months(database)[0] == Month("2026-12", {}, 0, 0, 0.0, 0, 0)
    assert draw(database, leases_[1])
    december, november = months(database)
    assert (december.month, december.jobs, december.looks, december.uploads) == ("2026-12", {"succeeded": 1}, 1, 0)
    assert (november.month, november.jobs, november.looks, november.uploads) == ("2026-11", {"succeeded": 2}, 1, 1)
    # east of Greenwich the year is over already
    assert ledger.month_of(datetime.fromisoformat("2027-01-01T01:00:00+02:00")) == "2026-12"


def test_of_a_clock_that_was_ahead_later_months_are_told_when_they_come(database: Database, clock: FakeClock) -> None:
    clock.time = NOVEMBER + timedelta(days=1)
    ready(database)
    clock.time = NOVEMBER
    assert [one.month for one in months(database)] == ["2026-11"]
    clock.time = NOVEMBER + timedelta(days=1)
    assert [(one.month, one.uploads) for one in months(database)] == [("2026-12", 1)]


def test_what_a_key_is_given_stays_counted_where_it_was_made(database: Database, clock: FakeClock) -> None:
    with database.write() as session:
        key, _ = keys.create(session, "studio", keys.Limits(), now=clock())
    medium = ready(database)
    assert draw(database, claim(database, ask(database, medium)))
    goes_on = claim(database, ask(database, medium))
    before = this_month(database)
    with database.write() as session:
        assert keys.adopt(session, session.merge(key)) == (1, 0)
    assert this_month(database) == before
    assert this_month(database, key.id).jobs == {}
    assert draw(database, goes_on)  # it ends as the job of who has it now
    assert this_month(database) == before
    assert (this_month(database, key.id).jobs, this_month(database, key.id).looks) == ({"succeeded": 1}, 1)
    with database.write() as session:
        keys.rotate(session.merge(key))
        keys.revoke(session, key, now=clock())
    assert this_month(database, key.id).looks == 1


def test_months_past_their_retention_go(database: Database, clock: FakeClock) -> None:
    for month in (
        datetime(2025, 10, 3, tzinfo=UTC),
        datetime(2025, 11, 3, tzinfo=UTC),
        datetime(2026, 1, 3, tzinfo=UTC),
    ):
        clock.time = month
        for owner in ("", "key_a"):
            add_media(database, owner=owner)
    clock.time = NOVEMBER
    with database.write() as session:
        assert sweep.expire_months(session, now=clock(), keep_months=14) == 0
        assert sweep.expire_months(session, now=clock(), keep_months=13) == 2
        assert sweep.expire_months(session, now=clock(), keep_months=13) == 0
    kept = ["2025-11", "2026-01"]
    with database.read() as session:
        assert [(one.month, owner) for owner, one in ledger.every(session)] == [
            (month, owner) for month in kept for owner in ("", "key_a")
        ]
        assert [owner for owner, _ in ledger.every(session, month="2026-01")] == ["", "key_a"]
    with database.write() as session:
        assert sweep.expire_months(session, now=clock(), keep_months=1) == 4
    assert months(database) == [Month("2026-11", {}, 0, 0, 0.0, 0, 0)]


def _cancel_all(url: str, job_ids: list[str], now: datetime) -> int:
    """What one process does: it ends jobs, some of which another one ends, too."""
    database = Database(url, clock=lambda: now)
    ended = 0
    for job_id in job_ids:
        with database.write() as session:
            ended += jobs.cancel(session, job_id, now=now)
    database.close()
    return ended


def test_of_two_processes_each_end_is_counted_once(database: Database, clock: FakeClock) -> None:
    media_of = [ready(database, owner) for owner in ("key_a", "key_b")]
    made = [ask(database, medium) for _ in range(30) for medium in media_of]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        ends = [pool.submit(_cancel_all, database.url, ids, clock()) for ids in (made, made[::-1])]
        assert sum(end.result(120) for end in ends) == len(made)
    for owner in ("key_a", "key_b"):
        assert this_month(database, owner) == Month("2026-11", {"succeeded": 1, "canceled": 30}, 0, 0, 0.0, 1, 10)


def test_who_ends_jobs_of_several_owners_waits_for_nobody_in_a_circle(database: Database, clock: FakeClock) -> None:
    """Counted at once, of two that end jobs of two owners, each in its order, one would have been a dead lock."""
    if database.url.startswith("sqlite"):
        pytest.skip("SQLite's writers take turns")
    media_of = [ready(database, owner) for owner in ("key_a", "key_b")]
    barrier = threading.Barrier(2, timeout=60)

    def end(ids: list[str]) -> None:
        with database.write() as session:
            for job_id in ids:
                assert jobs.revoke(session, job_id, now=clock())
                barrier.wait()

    orders = [[ask(database, medium) for medium in media_of], [ask(database, medium) for medium in media_of[::-1]]]
    with ThreadPoolExecutor(2) as pool:
        for done in [pool.submit(end, ids) for ids in orders]:
            done.result(60)
    assert [this_month(database, owner).jobs["canceled"] for owner in ("key_a", "key_b")] == [2, 2]


def test_a_key_whose_month_is_being_written_keeps_no_other_waiting(database: Database, clock: FakeClock) -> None:
    if database.url.startswith("sqlite"):
        pytest.skip("SQLite's writers take turns")
    first, second = ready(database, "key_a"), ready(database, "key_b")
    other = ask(database, second)
    with database.write() as session:
        session.scalars(select(MonthlyUsage).where(MonthlyUsage.owner == "key_a").with_for_update()).all()
        with database.write() as another:
            assert jobs.revoke(another, other, now=clock())
        # nor does one of the same key hold up who asks for a transfer
        assert ask(database, first)
    assert this_month(database, "key_b").jobs == {"succeeded": 1, "canceled": 1}
