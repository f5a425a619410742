"""Blobs that are written under a lease, and what becomes of them when it is lost."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from service.catalog import Database, Lease, jobs, leases, media, tombstones
from service.catalog.models import Tombstone
from service.catalog.parts import CANCELED
from service.catalog.transitions import Step
from tests.service.fixtures import FakeClock, add_media, add_transfer, claim, held_up
from tests.waiting import until


def due(database: Database) -> list[str]:
    with database.read() as session:
        return tombstones.due(session, now=database.now(), limit=10)


def take(database: Database, *keys: str) -> list[str]:
    with database.write() as session:
        return tombstones.take(session, keys, now=database.now())


def expect(database: Database, key: str, lease: Lease) -> None:
    with database.write() as session:
        tombstones.expect(session, key, now=database.now(), within_s=7800, lease=lease)


def abandoned(database: Database, key: str) -> None:
    """A blob that is written under a lease which is revoked."""
    medium = add_media(database)
    expect(database, key, claim(database, medium.job_id))
    with database.write() as session:
        jobs.revoke(session, medium.job_id, now=database.now())


@pytest.mark.parametrize("how", ["requeued", "given back", "given up", "failed", "canceled", "revoked"])
def test_what_is_written_under_a_lease_is_due_when_the_lease_is_lost(
    database: Database, clock: FakeClock, how: str
) -> None:
    medium = add_media(database)
    lease = claim(database, medium.job_id)
    expect(database, "asset/x", lease)
    clock.forward(100)  # longer than the lease, which nobody has taken
    assert (due(database), take(database, "asset/x")) == ([], [])
    with database.write() as session:
        now = clock()
        match how:
            case "requeued" | "given up":
                leases.reap(session, now=now, max_attempts=3 if how == "requeued" else 1)
            case "given back":
                assert leases.give_back(session, lease, now=now)
            case "failed":
                assert leases.fail(session, lease, CANCELED, now=now, timings={})
            case "canceled":
                assert jobs.cancel(session, medium.job_id, now=now)
                assert jobs.end(session, Step.CONFIRM_CANCEL, medium.job_id, now=now, error=CANCELED, lease=lease)
            case _:
                assert jobs.revoke(session, medium.job_id, now=now)
    assert due(database) == ["asset/x"]
    assert take(database, "asset/x") == ["asset/x"]


def test_a_worker_that_comes_late_writes_what_is_due_at_once(database: Database) -> None:
    medium = add_media(database)
    late = claim(database, medium.job_id)
    with database.write() as session:
        leases.give_back(session, late, now=database.now())
    next_one = claim(database, medium.job_id)
    expect(database, "asset/late", late)
    expect(database, "asset/next", next_one)
    assert due(database) == ["asset/late"]


def test_what_somebody_may_still_be_writing_is_deleted_once_more(database: Database, clock: FakeClock) -> None:
    abandoned(database, "asset/x")
    for _ in range(2):
        assert take(database, "asset/x") == ["asset/x"]
        with database.write() as session:
            tombstones.gone(session, ["asset/x"], now=clock())
        assert due(database) == []
        clock.forward(tombstones.WRITER_S)
    with database.read() as session:
        assert session.query(Tombstone).count() == 0


def test_a_failed_deletion_of_it_waits_for_the_next_one(database: Database, clock: FakeClock) -> None:
    abandoned(database, "asset/x")
    assert take(database, "asset/x") == ["asset/x"]
    assert (due(database), take(database, "asset/x")) == ([], [])
    clock.forward(tombstones.FIRST_WAIT_S)
    assert due(database) == ["asset/x"]


@pytest.mark.parametrize("step", ["take", "gone", "bury", "recorded"])
def test_those_who_handle_the_same_blobs_do_not_wait_for_each_other(database: Database, step: str) -> None:
    """Each had a row that the other one waited for: a deadlock on PostgreSQL, with more than one API."""
    keys = ["asset/b", "asset/a"]
    for key in keys:
        with database.write() as session:
            tombstones.bury(session, [key], now=database.now())

    def handle() -> None:
        with database.write() as session:
            if step == "recorded":
                tombstones.recorded(session, keys)
            else:
                getattr(tombstones, step)(session, keys, now=database.now())

    with ThreadPoolExecutor() as threads:
        with database.write() as session:
            assert tombstones.take(session, ["asset/a"], now=database.now())
            other = threads.submit(handle)
            until(lambda: other.done() or held_up(database) == 1)
            assert tombstones.take(session, ["asset/b"], now=database.now())
        other.result()


def test_its_writer_deletes_it_for_good(database: Database, clock: FakeClock) -> None:
    medium = add_media(database)
    lease = claim(database, medium.job_id)
    expect(database, "asset/x", lease)
    with database.write() as session:
        tombstones.bury(session, ["asset/x"], now=clock())
    assert take(database, "asset/x") == ["asset/x"]
    with database.write() as session:
        tombstones.gone(session, ["asset/x"], now=clock())
        assert session.get(Tombstone, "asset/x") is None


def test_the_blobs_that_are_written_for_a_job_are_known(database: Database) -> None:
    medium = add_media(database)
    lease = claim(database, medium.job_id)
    with database.write() as session:
        tombstones.expect(session, "asset/a", now=database.now(), within_s=900)
        media.finish(session, lease, media.Asset("asset/a", 1, {}, [], []), now=database.now(), timings={})
    job_id = add_transfer(database, medium, medium)
    with database.write() as session:
        jobs.release(session, now=database.now())
    expect(database, "result/x", claim(database, job_id))
    with database.read() as session:
        assert tombstones.written_for(session, [job_id]) == ["result/x"]
        assert tombstones.written_for(session, [medium.job_id]) == []
