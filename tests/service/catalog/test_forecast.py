"""Places and times of jobs, on made-up histories: what is told is what then happens, most of the time."""

from __future__ import annotations

import math
import random
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import update

from service.catalog import (
    Database,
    Job,
    JobKind,
    JobState,
    Media,
    MediaState,
    Role,
    forecast,
    jobs,
    leases,
    media,
    workers,
)
from service.catalog.forecast import Forecast
from tests.service.fixtures import FakeClock, add_media, add_transfer, claim

INFO = {"kind": "video", "width": 640, "height": 360, "frame_count": 100}
#: seconds that the made-up machine takes for a pixel of a frame
PACE = 2e-6


def video(database: Database, frames: int = 100) -> Media:
    """A medium that is ready, without a job to vectorise it."""
    medium = add_media(database)
    ready(database, medium, {**INFO, "frame_count": frames})
    return medium


def ready(database: Database, medium: Media, info: dict[str, Any]) -> None:
    with database.write() as session:
        session.execute(update(Media).where(Media.id == medium.id).values(state="ready", info=info))
        session.execute(update(Job).where(Job.id == medium.job_id).values(state=JobState.CANCELED))


def queue(database: Database, medium: Media, owner: str = "") -> str:
    job_id = add_transfer(database, medium, medium)
    with database.write() as session:
        session.execute(update(Job).where(Job.id == job_id).values(owner=owner))
        jobs.release(session, now=database.now())
    return job_id


def work(database: Database, clock: FakeClock, job_id: str, seconds: float) -> None:
    """Do a job from beginning to end."""
    lease = claim(database, job_id, lease_s=1e6)
    clock.forward(seconds)
    with database.write() as session:
        assert leases.succeed(session, lease, now=clock(), timings={})


def seconds_of(rng: random.Random, frames: int) -> float:
    return PACE * frames * 640 * 360 * math.exp(rng.gauss(0, 0.25))


def told(database: Database, *job_ids: str) -> dict[str, Forecast]:
    with database.read() as session:
        found = [job for job in (jobs.get(session, job_id) for job_id in job_ids) if job is not None]
        measured = forecast.history(session)
        return forecast.forecasts(session, found, measured, alive_since=database.now() - timedelta(seconds=15))


def live(database: Database, count: int) -> None:
    with database.write() as session:
        for k in range(count):
            workers.beat(session, f"worker-{k}", now=database.now())


def test_nothing_is_said_where_nothing_was_measured(database: Database) -> None:
    live(database, 1)
    first = queue(database, video(database))
    assert told(database, first)[first] == Forecast(position=1, eta=None)


def test_nothing_is_said_of_jobs_that_wait_for_media_or_have_ended(database: Database, clock: FakeClock) -> None:
    done = queue(database, video(database))
    work(database, clock, done, 1)
    waiting = add_transfer(database, add_media(database), add_media(database))
    assert told(database, done, waiting) == {}


def test_places_count_ones_own_and_take_turns_with_others(database: Database, clock: FakeClock) -> None:
    medium = video(database)
    mine = []
    for owner in ["many"] * 5 + ["few"] * 2:
        clock.forward(1)
        mine.append(queue(database, medium, owner))
    found = told(database, *mine)
    # many, few, many, few, many, many, many: the first of `many` came first
    assert [found[one].position for one in mine] == [1, 3, 5, 6, 7, 2, 4]
    assert told(database, mine[3])[mine[3]].position == 6  # asked for alone, the same


def test_without_workers_there_is_a_place_and_no_time(database: Database, clock: FakeClock) -> None:
    medium = video(database)
    for _ in range(3):
        work(database, clock, queue(database, medium), 10)
    only = queue(database, medium)
    assert told(database, only)[only].eta is None
    live(database, 1)
    eta = told(database, only)[only].eta
    assert eta is not None
    assert eta.seconds == pytest.approx(10, rel=0.01)


@pytest.mark.parametrize("slots", [1, 3])
def test_a_queued_job_ends_within_its_span_three_times_in_four(slots: int) -> None:
    rng = random.Random(7)
    within, trials = 0, 300
    for _ in range(trials):
        past = [rng.choice([50, 100, 200, 400]) for _ in range(40)]
        took = [seconds_of(rng, frames) for frames in past]
        paces = sorted(seconds / frames for seconds, frames in zip(took, past, strict=True))
        measured = forecast.History({"render": paces}, {"render": took})
        before = rng.randrange(60)
        free = [0.0] * slots
        for frames in (rng.choice([50, 100, 200, 400]) for _ in range(before)):
            free[free.index(min(free))] += seconds_of(rng, frames)
        ends = min(free) + seconds_of(rng, 200)
        load = forecast.Load(
            slots, 0, 0.0, {"render": {"": forecast.Waiting({"render": before + 1}, datetime.now(UTC))}}
        )
        own = forecast.usual("render", 200, measured)
        likely = forecast.until_done(load, measured, "render", {"render": before}, own)
        assert likely is not None
        assert likely.low <= likely.seconds <= likely.high
        within += likely.low <= ends <= likely.high
    print(f"{slots} workers: {within / trials:.2f} of {trials} within their span")
    assert within / trials > 0.7


def test_a_running_job_is_judged_by_its_own_pace_the_more_it_has_done(database: Database, clock: FakeClock) -> None:
    medium = video(database)
    for seconds in (8, 9, 10, 11, 12):
        work(database, clock, queue(database, medium), seconds)
    live(database, 1)
    slow = queue(database, medium)
    lease = claim(database, slow, lease_s=1e6)
    left = []
    for fraction in (0.0, 0.25, 0.5, 0.75):  # it takes 40 s, four times as long as the others
        with database.write() as session:
            step = leases.Progress("render", fraction, int(100 * fraction), 100)
            assert leases.report(session, lease, step, now=clock())
        eta = told(database, slow)[slow].eta
        assert eta is not None
        left.append(eta.seconds)
        clock.forward(10)
    assert left[0] == pytest.approx(10, rel=0.05)
    assert abs(left[3] - 10) < abs(left[0] - 40)
    assert 7 < left[3] < 10.5  # 10 s are left, and others would have left 2.5


def vectorized(database: Database, clock: FakeClock, role: Role, seconds: float, owner: str = "") -> Media:
    """A medium whose vectorisation took so long."""
    medium = add_media(database, role, owner=owner)
    work(database, clock, medium.job_id, seconds)
    return medium


def eta_of(database: Database, medium: Media) -> float | None:
    eta = told(database, medium.job_id)[medium.job_id].eta
    return None if eta is None else eta.seconds


def test_a_video_is_judged_by_videos_however_many_references_came_since(database: Database, clock: FakeClock) -> None:
    for _ in range(3):
        vectorized(database, clock, Role.VIDEO, 60)
    for _ in range(45):
        vectorized(database, clock, Role.REFERENCE, 0.5)
    live(database, 1)
    assert eta_of(database, add_media(database)) == pytest.approx(60, rel=0.01)
    with database.read() as session:
        measured = forecast.history(session)
    assert {deed: len(of_one) for deed, of_one in measured.durations.items()} == {
        "vectorize video": 3,
        "vectorize reference": 40,
    }


def test_the_newest_forty_looks_are_measured_of_transfers_and_swaps_together(
    database: Database, clock: FakeClock
) -> None:
    medium = video(database)
    for number, kind in enumerate([JobKind.SWAP] * 30 + [JobKind.TRANSFER] * 30):
        job_id = queue(database, medium)
        with database.write() as session:
            session.execute(update(Job).where(Job.id == job_id).values(kind=kind))
        work(database, clock, job_id, 1 + number)
    with database.read() as session:
        measured = forecast.history(session)
    assert measured.durations["render"] == pytest.approx([60 - k for k in range(40)])
    assert len(measured.paces["render"]) == 40


@pytest.mark.parametrize("owner", ["", "another"])
def test_who_waits_behind_clips_waits_for_clips(owner: str, database: Database, clock: FakeClock) -> None:
    for _ in range(5):
        vectorized(database, clock, Role.VIDEO, 60)
        vectorized(database, clock, Role.REFERENCE, 0.5)
    live(database, 1)
    for _ in range(10):
        add_media(database, owner=owner)
    before = 1 if owner else 10  # others take turns
    clock.forward(1)
    behind = add_media(database, Role.REFERENCE)
    assert eta_of(database, behind) == pytest.approx(60 * before + 0.5, rel=0.01)
    clock.forward(1)
    later = [add_media(database, Role.REFERENCE) for _ in range(20)]
    assert eta_of(database, behind) == pytest.approx(60 * before + 0.5, rel=0.01)  # whatever comes after it
    found = told(database, behind.job_id, later[0].job_id)
    etas = [found[medium.job_id].eta for medium in (behind, later[0])]
    assert [eta and eta.seconds for eta in etas] == [
        pytest.approx(60 * before + 0.5, rel=0.01),
        pytest.approx(60 * (2 if owner else 10) + 1, rel=0.01),
    ]


def test_a_job_at_work_is_waited_for_as_long_as_its_like_take(database: Database, clock: FakeClock) -> None:
    for _ in range(5):
        vectorized(database, clock, Role.VIDEO, 60)
        vectorized(database, clock, Role.REFERENCE, 0.5)
    live(database, 1)
    claim(database, add_media(database).job_id, lease_s=1e6)
    assert eta_of(database, add_media(database, Role.REFERENCE)) == pytest.approx(60.5, rel=0.01)


def test_a_medium_that_was_vectorised_again_is_measured_each_time(database: Database, clock: FakeClock) -> None:
    medium = vectorized(database, clock, Role.VIDEO, 60)
    for _ in range(2):
        with database.write() as session:
            session.execute(update(Media).where(Media.id == medium.id).values(state=MediaState.FAILED))
            failed = session.get_one(Media, medium.id)
            assert media.vectorize_again(session, failed, now=database.now())
            session.refresh(failed)
            job_id = failed.job_id
        work(database, clock, job_id, 60)
    live(database, 1)
    assert eta_of(database, add_media(database)) == pytest.approx(60, rel=0.01)


def test_two_hundred_jobs_cost_no_more_queries_than_one(database: Database) -> None:
    from sqlalchemy import event

    medium = video(database)
    live(database, 1)
    ids = [queue(database, medium) for _ in range(20)]
    counted: list[str] = []
    event.listen(database._engine, "before_cursor_execute", lambda *given: counted.append(given[2]))
    told(database, ids[0])
    one = len(counted)
    counted.clear()
    told(database, *ids)
    # each job is loaded by its id, here
    assert len(counted) - len(ids) <= one
