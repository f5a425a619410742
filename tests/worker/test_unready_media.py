"""Jobs that are taken while a medium of theirs is made again: they wait for it, and do not work."""

from __future__ import annotations

from datetime import timedelta

import pytest

from service.catalog import Asset, Database, Job, Media, jobs, media, parts
from service.catalog.parts import NewPart
from tests.service.fixtures import add_media, add_transfer, announce, claim, job_of
from worker.runner import Runner


def vectorize(database: Database, media_id: str, key: str, *, ahead: timedelta = timedelta(0)) -> None:
    """Do the job that vectorises a medium, by a clock that is ahead, and release those that wait for it."""
    with database.read() as session:
        lease = claim(database, session.get_one(Media, media_id).job_id)
    with database.write() as session:
        announce(session, key)
        asset, now = Asset(key, 1, {}, [], []), database.now() + ahead
        assert media.finish(session, lease, asset, now=now, timings={}) is not None
    with database.write() as session:
        jobs.release(session, now=database.now())


def make_again(database: Database, job_id: str, media_id: str, key: str) -> None:
    """What a job does that finds the asset of this key lost."""
    lease = claim(database, job_id)
    with database.write() as session:
        assert media.make_again(session, lease, {media_id: key}, now=database.now())


def test_a_job_of_a_medium_that_is_made_again_waits_and_costs_no_attempt(runner: Runner) -> None:
    database = runner._database
    medium = add_media(database)
    first, second = (add_transfer(database, medium, medium) for _ in range(2))
    vectorize(database, medium.id, "asset/first")
    make_again(database, first, medium.id, "asset/first")
    assert not job_of(database, second).waiting
    runner.run(second)
    job = job_of(database, second)
    assert (job.state, job.waiting, job.attempt, job.error) == ("queued", True, 1, None)
    vectorize(database, medium.id, "asset/second")
    assert [job_of(database, one).waiting for one in (first, second)] == [False, False]


@pytest.mark.parametrize("is_over", [False, True])
@pytest.mark.parametrize("joining", [False, True])
def test_parts_of_two_assets_are_never_joined(runner: Runner, joining: bool, is_over: bool) -> None:
    database = runner._database
    medium = add_media(database)
    another, whole_id = (add_transfer(database, medium, medium) for _ in range(2))
    vectorize(database, medium.id, "asset/first")
    lease = claim(database, whole_id)
    with database.write() as session:
        wanted = [NewPart(medium.id, 0, 100), NewPart(medium.id, 100, 200)]
        made = parts.split(session, lease, wanted, now=database.now(), timings={}) or []
    for message in made if joining else made[:1]:
        drawn = claim(database, message.job_id)
        with database.write() as session:
            following = parts.finish(session, drawn, [], now=database.now(), timings={}) or []
    make_again(database, another, medium.id, "asset/first")
    if is_over:
        vectorize(database, medium.id, "asset/second")
    runner.run((following if joining else made[1:])[0].job_id)
    whole = job_of(database, whole_id)
    assert (whole.state, whole.waiting, whole.attempt, whole.error) == ("queued", not is_over, 1, None)
    with database.read() as session:
        assert session.query(Job).filter_by(parent_id=whole_id).count() == 0
    if not is_over:
        vectorize(database, medium.id, "asset/second")
    # begun anew, its parts are drawn by the new asset
    lease = claim(database, whole_id)
    with database.write() as session:
        (message,) = parts.split(session, lease, wanted[:1], now=database.now(), timings={}) or []
        part, present = session.get_one(Job, message.job_id), [session.get_one(Media, medium.id)]
        assert media.unready(session, part, present) == set()


def test_a_clock_that_was_set_back_makes_no_part_wait_for_media_that_are_ready(runner: Runner) -> None:
    database = runner._database
    medium = add_media(database)
    whole_id = add_transfer(database, medium, medium)
    vectorize(database, medium.id, "asset/first", ahead=timedelta(minutes=10))
    lease = claim(database, whole_id)
    with database.write() as session:
        (message,) = parts.split(session, lease, [NewPart(medium.id, 0, 100)], now=database.now(), timings={}) or []
        part, present = session.get_one(Job, message.job_id), [session.get_one(Media, medium.id)]
        assert media.unready(session, part, present) == set()
