from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import partial
from typing import Any

import pytest
from sqlalchemy import Connection, event
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service.catalog import (
    Asset,
    Database,
    Filter,
    Job,
    JobKind,
    JobState,
    Lease,
    Media,
    Progress,
    Role,
    VectorizeRequest,
    amounts,
    jobs,
    leases,
    ledger,
    media,
    sweep,
)
from service.catalog.messages import Message
from tests.service.fixtures import FakeClock, add_media, add_transfer, announce, claim, held_up, job_of
from tests.side_by_side import at_once
from tests.waiting import until

PROBLEM = {"type": "no-face", "title": "No face was found", "detail": "no face found"}


def media_of(database: Database, media_id: str) -> Media:
    with database.read() as session:
        medium = media.get(session, media_id)
    assert medium is not None
    return medium


def step(database: Database, name: str, *args: Any, **options: Any) -> Any:
    with database.write() as session:
        module = jobs if hasattr(jobs, name) else leases
        return getattr(module, name)(session, *args, now=database.now(), **options)


def state_held(database: Database, lease: Lease) -> JobState | None:
    with database.read() as session:
        return leases.held_state(session, lease)


def finish_media(database: Database, medium: Media) -> None:
    lease = claim(database, medium.job_id)
    with database.write() as session:
        asset = Asset("asset/x", 1, {}, [], [])
        announce(session, "asset/x")
        assert media.finish(session, lease, asset, now=database.now(), timings={}) == []


def test_of_many_claims_one_wins(database: Database) -> None:
    job_id = add_media(database).job_id

    def try_it() -> Lease | None:
        with database.write() as session:
            return leases.claim(session, job_id, now=database.now(), lease_s=30)

    won = at_once([try_it] * 8)
    assert sum(lease is not None for lease in won) == 1
    assert job_of(database, job_id).attempt == 1


def test_a_lapsed_lease_returns_the_job_and_the_late_worker_changes_nothing(
    database: Database, clock: FakeClock
) -> None:
    job_id = add_media(database).job_id
    late = claim(database, job_id)
    clock.forward(31)
    assert [message.job_id for message in step(database, "reap", max_attempts=3)] == [job_id]
    assert (job_of(database, job_id).state, job_of(database, job_id).attempt) == ("queued", 2)
    second = claim(database, job_id)
    assert not step(database, "succeed", late, timings={})
    assert not step(database, "fail", late, PROBLEM, timings={})
    assert not step(database, "report", late, Progress("skin", 0.9, 9, 10))
    assert not step(database, "renew", late, lease_s=30)
    assert step(database, "succeed", second, timings={})
    # and after the end neither of them does
    assert not step(database, "fail", second, PROBLEM, timings={})
    job = job_of(database, job_id)
    assert (job.state, job.error, job.lease_token) == ("succeeded", None, None)


def test_a_heartbeat_keeps_the_lease(database: Database, clock: FakeClock) -> None:
    lease = claim(database, add_media(database).job_id)
    for _ in range(5):
        clock.forward(20)
        assert step(database, "renew", lease, lease_s=30)
        assert state_held(database, lease) is JobState.RUNNING
        assert step(database, "reap", max_attempts=3) == []


def test_the_third_crash_is_the_last(database: Database, clock: FakeClock) -> None:
    medium = add_media(database)
    for attempt in (1, 2, 3):
        claim(database, medium.job_id)
        assert job_of(database, medium.job_id).attempt == attempt
        clock.forward(31)
        step(database, "reap", max_attempts=3)
    job = job_of(database, medium.job_id)
    assert job.state == "failed"
    assert job.error is not None
    assert job.error["type"] == "worker-crashed"
    assert media_of(database, medium.id).state == "failed"
    with database.write() as session:
        assert leases.claim(session, medium.job_id, now=database.now(), lease_s=30) is None


def test_a_queued_job_is_canceled_at_once_and_cannot_be_claimed(database: Database) -> None:
    job_id = add_media(database).job_id
    assert step(database, "cancel", job_id)
    assert job_of(database, job_id).state == "canceled"
    with database.write() as session:
        assert leases.claim(session, job_id, now=database.now(), lease_s=30) is None
    assert not step(database, "cancel", job_id)


def test_a_running_job_is_canceled_by_its_worker(database: Database) -> None:
    job_id = add_media(database).job_id
    lease = claim(database, job_id)
    assert step(database, "cancel", job_id)
    assert step(database, "renew", lease, lease_s=30)
    assert state_held(database, lease) is JobState.CANCELING
    assert not step(database, "succeed", lease, timings={})
    assert not step(database, "fail", lease, PROBLEM, timings={})
    assert step(database, "confirm_cancel", lease)
    assert job_of(database, job_id).state == "canceled"


def test_a_job_given_back_while_it_is_canceled_does_not_escape(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    lease = claim(database, add_media(database).job_id)
    given, end = threading.Event(), jobs.end

    def give_back() -> None:
        step(database, "give_back", lease)
        given.set()

    other = threading.Thread(target=give_back)

    def end_slowly(*args: Any, **options: Any) -> bool:
        ended = end(*args, **options)
        other.start()
        until(lambda: held_up(database) or given.is_set())
        return ended

    monkeypatch.setattr(jobs, "end", end_slowly)
    assert step(database, "cancel", lease.job_id)
    other.join()
    assert job_of(database, lease.job_id).state == "canceling"


def test_a_canceled_job_whose_worker_died_is_ended_by_the_reaper(database: Database, clock: FakeClock) -> None:
    job_id = add_media(database).job_id
    claim(database, job_id)
    step(database, "cancel", job_id)
    clock.forward(31)
    assert step(database, "reap", max_attempts=3) == []
    assert job_of(database, job_id).state == "canceled"


def test_cancel_and_success_at_the_same_moment_have_one_end(database: Database) -> None:
    for _ in range(20):
        job_id = add_media(database).job_id
        lease = claim(database, job_id)
        cancel = partial(step, database, "cancel", job_id)
        canceled, succeeded = at_once([cancel, partial(step, database, "succeed", lease, timings={})])
        assert canceled != succeeded
        if canceled:
            assert step(database, "confirm_cancel", lease)
        assert job_of(database, job_id).state == ("canceled" if canceled else "succeeded")


def test_a_revoked_job_takes_the_lease_away(database: Database) -> None:
    job_id = add_media(database).job_id
    lease = claim(database, job_id)
    assert step(database, "revoke", job_id)
    with database.read() as session:
        assert leases.held_state(session, lease) is None
    assert not step(database, "succeed", lease, timings={})
    assert not step(database, "confirm_cancel", lease)


def test_a_job_left_in_the_queue_expires_with_its_medium(database: Database, clock: FakeClock) -> None:
    medium = add_media(database)
    clock.forward(100)
    assert step(database, "expire", before=clock()) == 1
    assert job_of(database, medium.job_id).state == "expired"
    assert media_of(database, medium.id).error == job_of(database, medium.job_id).error


def test_the_time_in_the_queue_counts_from_the_last_attempt(database: Database, clock: FakeClock) -> None:
    job_id = add_media(database).job_id
    clock.forward(100)
    claim(database, job_id)
    clock.forward(31)
    assert len(step(database, "reap", max_attempts=3)) == 1
    clock.forward(60)
    assert step(database, "expire", before=clock() - timedelta(seconds=61)) == 0
    assert job_of(database, job_id).state == "queued"
    assert step(database, "expire", before=clock() - timedelta(seconds=59)) == 1
    assert job_of(database, job_id).state == "expired"


def test_jobs_are_released_in_the_order_of_their_requests(database: Database, clock: FakeClock) -> None:
    video = add_media(database)
    ids = [add_transfer(database, video, video) for _ in range(4)]
    with database.write() as session:  # written last, which PostgreSQL finds last
        session.get_one(Job, ids[0]).fingerprint = "another"
    lease = claim(database, video.job_id)
    with database.write() as session:
        announce(session, "asset/x")
        media.finish(session, lease, Asset("asset/x", 1, {}, [], []), now=clock(), timings={})
    with database.write() as session:
        assert [message.job_id for message in jobs.release(session, now=clock())] == ids


def test_the_time_in_the_queue_counts_from_the_release(database: Database, clock: FakeClock) -> None:
    video = add_media(database)
    job_id = add_transfer(database, video, video)
    lease = claim(database, video.job_id, lease_s=1000)
    clock.forward(500)
    with database.write() as session:
        asset = Asset("asset/x", 1, {}, [], [])
        announce(session, "asset/x")
        assert media.finish(session, lease, asset, now=database.now(), timings={}) == []
    assert len(step(database, "release")) == 1
    clock.forward(60)
    assert step(database, "expire", before=clock() - timedelta(seconds=61)) == 0
    claim(database, job_id)
    assert job_of(database, job_id).timings == {"waited_s": 500.0}


def test_a_job_that_is_given_back_keeps_its_attempt_unless_it_was_spent(database: Database) -> None:
    job_id = add_media(database).job_id
    lease = claim(database, job_id)
    assert step(database, "give_back", lease)
    assert not step(database, "give_back", lease)
    assert not step(database, "succeed", lease, timings={})
    job = job_of(database, job_id)
    assert (job.state, job.attempt, job.published_at) == ("queued", 1, None)
    assert step(database, "give_back", claim(database, job_id), costs_attempt=True)
    assert job_of(database, job_id).attempt == 2
    lease = claim(database, job_id)
    assert step(database, "cancel", job_id)
    assert not step(database, "give_back", lease)


def test_a_job_that_waits_too_long_for_its_media_expires(database: Database, clock: FakeClock) -> None:
    video = add_media(database)
    job_id = add_transfer(database, video, video)
    claim(database, video.job_id, lease_s=1000)
    clock.forward(100)
    assert step(database, "expire", before=clock() - timedelta(seconds=99)) == 1
    assert job_of(database, job_id).state == "expired"


def test_a_transfer_waits_for_all_of_its_media(database: Database) -> None:
    video, reference = add_media(database), add_media(database, Role.REFERENCE)
    job_id = add_transfer(database, video, reference)
    assert step(database, "release") == []
    with database.write() as session:
        assert leases.claim(session, job_id, now=database.now(), lease_s=30) is None
    finish_media(database, video)
    assert step(database, "release") == []
    finish_media(database, reference)
    assert [message.job_id for message in step(database, "release")] == [job_id]
    assert step(database, "release") == []
    claim(database, job_id)


def test_a_failed_medium_fails_the_jobs_that_wait_for_it_with_its_own_error(database: Database) -> None:
    video, reference = add_media(database), add_media(database, Role.REFERENCE)
    waiting, other = add_transfer(database, video, reference), add_transfer(database, video, video)
    lease = claim(database, reference.job_id)
    assert step(database, "fail", lease, PROBLEM, timings={})
    step(database, "release")
    assert media_of(database, reference.id).state == "failed"
    assert job_of(database, waiting).state == "failed"
    errors = [{"pointer": "/looks/0/reference", "detail": PROBLEM["detail"]}]
    assert job_of(database, waiting).error == PROBLEM | {"errors": errors}
    assert job_of(database, other).state == "queued"


def test_progress_is_of_the_present_attempt(database: Database, clock: FakeClock) -> None:
    job_id = add_media(database).job_id
    lease = claim(database, job_id)
    assert step(database, "report", lease, Progress("landmarks", 0.25, 5, 20))
    job = job_of(database, job_id)
    assert (job.stage, job.fraction, job.frames_done, job.frames_total) == ("landmarks", 0.25, 5, 20)
    clock.forward(31)
    step(database, "reap", max_attempts=3)
    job = job_of(database, job_id)
    assert (job.state, job.stage, job.fraction, job.frames_done, job.frames_total) == ("queued", None, 0.0, 0, 0)
    claim(database, job_id)
    assert (job_of(database, job_id).stage, job_of(database, job_id).fraction) == (None, 0.0)


def test_a_job_that_succeeded_has_done_all_its_frames(database: Database) -> None:
    """Reports are throttled; the last one before the end is not of the last frame."""
    job_id = add_media(database).job_id
    lease = claim(database, job_id)
    assert step(database, "report", lease, Progress("skin", 0.9, 15, 20))
    assert step(database, "succeed", lease, timings={})
    job = job_of(database, job_id)
    assert (job.state, job.fraction, job.frames_done, job.frames_total) == ("succeeded", 1.0, 20, 20)


def test_the_same_content_is_recorded_once_a_role(database: Database) -> None:
    add_media(database, content=b"same")
    add_media(database, Role.REFERENCE, content=b"same")
    with pytest.raises(IntegrityError):
        add_media(database, content=b"same")


def test_an_owners_jobs_are_chosen_by_metadata(database: Database) -> None:
    made = []
    with database.write() as session:
        for owner, metadata in (("key_a", {"a.b": "1", "c": "ü"}), ("key_a", {"a.b": "2"}), ("key_b", {"a.b": "1"})):
            request = VectorizeRequest(Role.VIDEO)
            now = database.now()
            job = jobs.create(session, JobKind.VECTORIZE, request=request, now=now, owner=owner, metadata=metadata)
            made.append(job.id)

    def chosen(**metadata: str) -> list[str]:
        with database.read() as session:
            found = jobs.page(session, "key_a", Filter(metadata=metadata), before=None, limit=9)
        return [job.id for job in found]

    assert chosen() == [made[1], made[0]]
    assert chosen(**{"a.b": "1"}) == chosen(**{"a.b": "1", "c": "ü"}) == [made[0]]
    assert chosen(c="1") == chosen(d="1") == []


def made_again(database: Database, job_id: str, medium: Media, key: str) -> list[Message] | None:
    """What comes of a job that finds the asset of this key lost."""
    lease = claim(database, job_id)
    with database.write() as session:
        return media.make_again(session, lease, {medium.id: key}, now=database.now())


def test_an_asset_that_another_job_has_had_made_again_is_waited_for_not_failed(
    database: Database, clock: FakeClock
) -> None:
    medium = add_media(database)
    first, second, third = (add_transfer(database, medium, medium) for _ in range(3))
    finish_media(database, medium)
    step(database, "release")
    clock.forward(1)
    (again,) = made_again(database, first, medium, "asset/x") or []
    with database.read() as session:
        found = [session.get_one(Media, medium.id)]
        assert media.made_since_asked(session, jobs.get(session, first), found) == set()  # type: ignore[arg-type]
    clock.forward(1)
    # one finds it lost while it is made, one when it is there again: both were taken after it was begun
    assert made_again(database, second, medium, "asset/x") == []
    lease = claim(database, third)
    clock.forward(1)
    finished = claim(database, again.job_id)
    with database.write() as session:
        announce(session, "asset/y")
        made = media.finish(session, finished, Asset("asset/y", 1, {}, [], []), now=clock(), timings={})
        assert made == ["asset/x"]
        found = [session.get_one(Media, medium.id)]
        assert media.made_since_asked(session, session.get_one(Job, first), found) == {medium.id}
    with database.write() as session:
        assert media.make_again(session, lease, {medium.id: "asset/x"}, now=clock()) == []
    assert job_of(database, third).waiting
    assert {message.job_id for message in step(database, "release")} == {first, second, third}
    # the new one cannot be read either: it is not made for ever
    assert made_again(database, third, medium, "asset/y") is None


@pytest.mark.parametrize("database", ["postgresql"], indirect=True)
@pytest.mark.parametrize("before", ["_media_error", "end"])
def test_a_job_whose_medium_is_uploaded_again_meanwhile_goes_on_waiting(
    database: Database, monkeypatch: pytest.MonkeyPatch, before: str
) -> None:
    medium = add_media(database)
    job_id = add_transfer(database, medium, medium)
    other = add_media(database)
    other_id = add_transfer(database, other, other)
    lease = claim(database, medium.job_id)
    with database.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=database.now(), timings={})
    finish_media(database, other)

    def upload(session: Session) -> None:
        assert media.vectorize_again(session, session.get_one(Media, medium.id), now=database.now())

    meanwhile(database, monkeypatch, before, upload)
    released = step(database, "release")
    assert [message.job_id for message in released] == [other_id]
    job = job_of(database, job_id)
    assert (job.state, job.waiting, job.error) == ("queued", True, None)


@pytest.mark.parametrize("database", ["postgresql"], indirect=True)
def test_a_job_whose_medium_is_made_again_meanwhile_is_not_released(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    medium = add_media(database)
    first = add_transfer(database, medium, medium)
    finish_media(database, medium)
    step(database, "release")
    lease = claim(database, first)
    second = add_transfer(database, medium, medium)

    def make_again(session: Session) -> None:
        assert media.make_again(session, lease, {medium.id: "asset/x"}, now=database.now())

    meanwhile(database, monkeypatch, "_waited", make_again)
    assert step(database, "release") == []
    assert job_of(database, second).waiting


def meanwhile(database: Database, monkeypatch: pytest.MonkeyPatch, before: str, act: Callable[[Session], None]) -> None:
    """Have another transaction act, once, before the function of this name of `jobs` is called."""
    usual = getattr(jobs, before)

    def interrupted(*given: Any, **named: Any) -> Any:
        monkeypatch.setattr(jobs, before, usual)
        with database.write() as session:
            act(session)
        return usual(*given, **named)

    monkeypatch.setattr(jobs, before, interrupted)


def test_what_an_owner_has_is_found_and_counted_by_indexes(database: Database) -> None:
    """Of some hundred thousand jobs and media of one key, each request read all of them: seconds, for a transfer."""
    medium = add_media(database)
    add_transfer(database, medium, medium)
    with database.read() as session, plans(database) as seen:
        for wanted in (Filter(states=["queued"]), Filter(states=["queued", "failed"]), Filter(video_id=medium.id)):
            jobs.page(session, "", wanted, before=None, limit=2)
        media.page(session, Role.VIDEO, owner="", states=["failed", "ready"], before=None, limit=2)
        jobs.find_same(session, "", "0" * 64, now=database.now())
        amounts.active_jobs(session, "")
        amounts.stored_bytes(session, "")
        amounts.next_expiry(session, "")
        ledger.months(session, "", now=database.now())
        sweep.expire_jobs(session, before=database.now())
        sweep.late_media(session, now=database.now())
        leases.reap(session, now=database.now(), max_attempts=3)
    for statement, plan in seen:
        assert not re.search(r"SCAN (?:jobs|media|looks|results)\b|Seq Scan", plan), (statement, plan)
    if database.url.startswith("sqlite"):  # it has no statistics, and these are read often
        for statement, plan in seen:
            assert not re.search(r"INDEX ix_(?:jobs|media|results)_owner(?:_id)? \(owner=\?\)", plan), (statement, plan)
        used = {word for _, plan in seen for word in re.findall(r"ix_\w+", plan)}
        assert used >= {
            "ix_jobs_owner_state_id",
            "ix_jobs_owner_fingerprint_id",
            "ix_jobs_kind_state_finished_at_owner_id",
            "ix_media_owner_role_state_id",
            "ix_media_owner_expires_at_size_bytes_asset_bytes",
            "ix_results_owner_expires_at_size_bytes",
        }


@contextmanager
def plans(database: Database) -> Iterator[list[tuple[str, str]]]:
    """The statements that are sent, each with its plan."""
    seen: list[tuple[str, str]] = []
    engine = database._engine
    is_server = engine.dialect.name == "postgresql"

    def note(connection: Connection, cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        if statement.startswith("SELECT"):
            look = connection.connection.cursor()
            if is_server:  # small tables are read as a whole where there is a choice
                look.execute("SET LOCAL enable_seqscan = off")
            look.execute(f"{'EXPLAIN' if is_server else 'EXPLAIN QUERY PLAN'} {statement}", parameters)
            seen.append((statement, "\n".join(str(row) for row in look.fetchall())))

    event.listen(engine, "before_cursor_execute", note)
    yield seen
    event.remove(engine, "before_cursor_execute", note)


def test_a_page_of_several_states_is_the_newest_of_all_of_them(database: Database) -> None:
    made = [add_media(database, content=bytes([k])) for k in range(6)]
    for medium in made[::2]:
        step(database, "cancel", medium.job_id)
    with database.read() as session:

        def page(*states: str, before: str | None = None) -> list[str | None]:
            found = jobs.page(session, "", Filter(states=states), before=before, limit=2)
            return [one.media_id for one in found]

        assert page("queued", "canceled") == [made[5].id, made[4].id]
        assert page("queued", "canceled", before=made[4].job_id) == [made[3].id, made[2].id]
        assert page("canceled") == page("canceled", "canceled", "failed") == [made[4].id, made[2].id]
        assert page("failed", "expired") == []
        failed = media.page(session, Role.VIDEO, owner="", states=["failed", "ready"], before=None, limit=2)
        assert [one.id for one in failed] == [made[4].id, made[2].id]
