"""Jobs that are done in parts: cut, drawn, joined, and brought to an end in every way a job may end."""

from __future__ import annotations

import threading
from collections import deque
from datetime import datetime, timedelta
from functools import partial

import pytest
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from service.catalog import (
    Asset,
    Database,
    Filter,
    Job,
    JobState,
    Lease,
    Message,
    Output,
    PartKind,
    Progress,
    amounts,
    fairness,
    forecast,
    jobs,
    leases,
    media,
    parts,
    results,
    statistics,
    sweep,
    tombstones,
)
from service.catalog.models import Part, PartFile, Tombstone
from service.catalog.parts import NewFile, NewPart
from tests.service.fixtures import FakeClock, add_media, add_transfer, announce, claim, held_up, job_of
from tests.side_by_side import at_once
from tests.waiting import until

PROBLEM = {"type": "media-invalid", "title": "t", "detail": "d"}
FRAMES = 100


def add_ready_transfer(database: Database, owner: str = "") -> tuple[str, str]:
    """A transfer whose medium is ready; the ids of both."""
    medium = add_media(database, owner=owner)
    job_id = add_transfer(database, medium, medium)
    lease = claim(database, medium.job_id)
    with database.write() as session:
        if owner:
            session.get_one(Job, job_id).owner = owner
        announce(session, f"asset/{medium.id}")
        asset = Asset(f"asset/{medium.id}", 1, {}, [], [])
        assert media.finish(session, lease, asset, now=database.now(), timings={}) == []
        jobs.release(session, now=database.now())
    return medium.id, job_id


def split(database: Database, job_id: str, count: int, video_id: str = "vid_1") -> list[str]:
    """Cut a queued job into so many parts; their ids."""
    lease = claim(database, job_id)
    wanted = [NewPart(video_id, k * FRAMES, (k + 1) * FRAMES) for k in range(count)]
    with database.write() as session:
        made = parts.split(session, lease, wanted, now=database.now(), timings={"queued_s": 1.0})
    assert made is not None
    assert {message.queue for message in made} == {"render"}
    return [message.job_id for message in made]


def parted(database: Database, count: int = 3, owner: str = "") -> tuple[str, list[str]]:
    _, job_id = add_ready_transfer(database, owner)
    return job_id, split(database, job_id, count)


def finish(database: Database, lease: Lease, *, seconds: float = 1.0) -> list[Message] | None:
    """End a part well, with a file of its own."""
    files = [NewFile(0, f"drawn/{lease.job_id}", 10)]
    with database.write() as session:
        announce(session, files[0].key)
        return parts.finish(session, lease, files, now=database.now(), timings={"render_s": seconds})


def draw_all(database: Database, part_ids: list[str]) -> str:
    """Do all the parts; the id of the join."""
    made = [message for part_id in part_ids for message in finish(database, claim(database, part_id)) or []]
    (join,) = made
    return join.job_id


def publish(database: Database, lease: Lease) -> bool:
    output = Output(f"res_{lease.token}", 0, f"result/{lease.token}", "0" * 64, 1, "video/mp4", "a.mp4")
    with database.write() as session:
        announce(session, output.key)
        return results.publish(session, lease, [output], now=database.now(), timings={"join_s": 1.0}, ttl_s=100)


def test_what_parts_have_drawn_is_among_what_their_owner_keeps(database: Database) -> None:
    job_id, part_ids = parted(database, owner="key_a")
    with database.read() as session:
        before = amounts.stored_bytes(session, "key_a")
    for part_id in part_ids[:2]:
        finish(database, claim(database, part_id))
    with database.read() as session:
        assert amounts.stored_bytes(session, "key_a") == before + 20
        assert amounts.stored_bytes(session, "key_b") == 0
    with database.write() as session:
        assert jobs.cancel(session, job_id, now=database.now())
    with database.read() as session:
        assert amounts.stored_bytes(session, "key_a") == before


def left(database: Database) -> tuple[int, int, int]:
    """Shares of jobs, parts and files of parts."""
    with database.read() as session:
        shares = session.scalar(select(func.count()).select_from(Job).where(Job.parent_id.is_not(None)))
        of_frames = session.scalar(select(func.count()).select_from(Part))
        files = session.scalar(select(func.count()).select_from(PartFile))
        return shares or 0, of_frames or 0, files or 0


def buried(database: Database) -> set[str]:
    with database.read() as session:
        return set(session.scalars(select(Tombstone.blob_key).where(Tombstone.due_at <= database.now())))


def test_a_job_in_parts_runs_without_a_lease_and_ends_with_its_join(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database)
    whole = job_of(database, job_id)
    assert (whole.state, whole.lease_token, whole.stage, whole.frames_total) == ("running", None, "render", 300)
    clock.forward(5)
    join_id = draw_all(database, [part_ids[2], part_ids[0], part_ids[1]])  # in any order
    assert job_of(database, join_id).kind == PartKind.JOIN
    with database.read() as session:
        drawn = parts.drawn(session, job_id)
    assert [(one.start, one.files) for one in drawn] == [
        (k * FRAMES, {0: f"drawn/{part_id}"}) for k, part_id in enumerate(part_ids)
    ]
    whole = job_of(database, job_id)
    assert (whole.state, whole.stage, whole.fraction, whole.frames_done) == ("running", "render", 0.97, 300)
    lease = claim(database, join_id)
    with database.write() as session:
        assert leases.report(session, lease, Progress("join", 0.5, 1, 2), now=clock())
    assert (job_of(database, job_id).stage, job_of(database, job_id).fraction) == ("join", 0.985)
    clock.forward(1)
    assert publish(database, lease)
    whole = job_of(database, job_id)
    assert (whole.state, whole.fraction, whole.finished_at) == ("succeeded", 1.0, clock())
    assert whole.timings == {"join_s": 1.0}
    with database.read() as session:
        (look,) = jobs.looks(session, job_id)
        result = results.get(session, look.result_id or "")
    assert result is not None
    assert result.job_id == job_id
    assert left(database) == (0, 0, 0)
    assert buried(database) == {f"drawn/{part_id}" for part_id in part_ids}


def test_parts_that_end_at_the_same_moment_add_one_join(database: Database, clock: FakeClock) -> None:
    for _ in range(5):
        job_id, part_ids = parted(database, 4)
        held = [claim(database, part_id) for part_id in part_ids]
        made = at_once([partial(finish, database, lease) for lease in held])
        assert sorted(len(one or ()) for one in made) == [0, 0, 0, 1]
        with database.read() as session:
            joins = select(func.count()).select_from(Job).where(Job.parent_id == job_id, Job.kind == PartKind.JOIN)
            assert session.scalar(joins) == 1


def test_a_part_is_ended_once_and_a_lost_answer_is_known(database: Database, clock: FakeClock) -> None:
    _, part_ids = parted(database, 2)
    lease = claim(database, part_ids[0])
    files = [NewFile(0, f"drawn/{part_ids[0]}", 10)]
    assert finish(database, lease) == []
    with database.write() as session:
        assert parts.finish(session, lease, files, now=clock(), timings={}) is None
        assert parts.is_finished(session, part_ids[0], files)
        assert not parts.is_finished(session, part_ids[1], files)


def test_a_cut_whose_answer_was_lost_is_not_made_again(database: Database, clock: FakeClock) -> None:
    _, job_id = add_ready_transfer(database)
    lease = claim(database, job_id)
    wanted = [NewPart("vid_1", 0, 100), NewPart("vid_1", 100, 200)]
    with database.write() as session:
        made = parts.split(session, lease, wanted, now=clock(), timings={})
    with database.write() as session:
        assert parts.split(session, lease, wanted, now=clock(), timings={}) == made
    assert left(database)[1] == 2


def test_a_job_that_is_being_canceled_is_not_cut(database: Database, clock: FakeClock) -> None:
    _, job_id = add_ready_transfer(database)
    lease = claim(database, job_id)
    with database.write() as session:
        assert jobs.cancel(session, job_id, now=clock())
        assert parts.split(session, lease, [NewPart("vid_1", 0, 9)], now=clock(), timings={}) is None
        assert leases.confirm_cancel(session, lease, now=clock())
    assert left(database) == (0, 0, 0)


def test_a_part_that_fails_ends_the_job_with_its_error(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database)
    finish(database, claim(database, part_ids[0]))
    lease, other = claim(database, part_ids[1]), claim(database, part_ids[2])
    with database.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=clock(), timings={})
    whole = job_of(database, job_id)
    assert (whole.state, whole.error) == ("failed", PROBLEM)
    assert left(database) == (0, 0, 0)
    assert buried(database) == {f"drawn/{part_ids[0]}"}
    with database.write() as session:  # the worker of another part finds its lease lost
        assert leases.held_state(session, other) is None
        assert not leases.renew(session, other, now=clock(), lease_s=30)
    assert finish(database, other) is None


def test_a_part_whose_worker_is_lost_is_done_again_and_no_other(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database)
    finish(database, claim(database, part_ids[0]))
    for attempt in (1, 2):
        claim(database, part_ids[1])
        clock.forward(31)
        with database.write() as session:
            assert leases.reap(session, now=clock(), max_attempts=3) == [Message(part_ids[1], "render")]
        assert job_of(database, part_ids[1]).attempt == attempt + 1
    assert job_of(database, part_ids[2]).attempt == 1
    lease = claim(database, part_ids[1])
    with database.write() as session:
        leases.report(session, lease, Progress("render", 0.5, 1, 2), now=clock())
    assert job_of(database, job_id).attempt == 3
    clock.forward(31)
    with database.write() as session:
        assert leases.reap(session, now=clock(), max_attempts=3) == []
    whole = job_of(database, job_id)
    assert (whole.state, (whole.error or {})["type"]) == ("failed", "worker-crashed")
    assert left(database) == (0, 0, 0)


def test_a_job_in_parts_is_canceled_when_the_last_worker_has_stopped(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database, 4)
    finish(database, claim(database, part_ids[0]))
    first, second = claim(database, part_ids[1]), claim(database, part_ids[2])
    with database.write() as session:
        assert jobs.cancel(session, job_id, now=clock())
    assert job_of(database, job_id).state == "canceling"
    assert [job_of(database, one).state for one in part_ids[1:]] == ["canceling", "canceling", "canceled"]
    assert finish(database, first) is None
    with database.write() as session:
        assert leases.confirm_cancel(session, first, now=clock())
    assert job_of(database, job_id).state == "canceling"
    clock.forward(31)  # the other one is lost: the reaper ends its part, and with it the job
    with database.write() as session:
        assert leases.reap(session, now=clock(), max_attempts=3) == []
    whole = job_of(database, job_id)
    assert (whole.state, (whole.error or {})["type"]) == ("canceled", "canceled")
    assert left(database) == (0, 0, 0)
    assert buried(database) == {f"drawn/{part_ids[0]}"}
    assert second.job_id == part_ids[2]


def test_a_job_none_of_whose_parts_is_taken_is_canceled_at_once(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database)
    finish(database, claim(database, part_ids[0]))
    with database.write() as session:
        assert jobs.cancel(session, job_id, now=clock())
    assert job_of(database, job_id).state == "canceled"
    with database.write() as session:
        assert not jobs.cancel(session, job_id, now=clock())
    assert left(database) == (0, 0, 0)


@pytest.mark.parametrize("joining", [False, True])
def test_a_cancel_and_the_end_of_the_last_part_or_the_join_leave_one_end(
    database: Database, clock: FakeClock, joining: bool
) -> None:
    ends = []
    for _ in range(6):
        job_id, part_ids = parted(database, 2)
        if joining:
            last = claim(database, draw_all(database, part_ids))
        else:
            finish(database, claim(database, part_ids[0]))
            last = claim(database, part_ids[1])

        def end(last: Lease = last) -> None:
            if not (publish(database, last) if joining else finish(database, last) is not None):
                with database.write() as session:
                    leases.confirm_cancel(session, last, now=clock())

        def stop(job_id: str = job_id) -> None:
            with database.write() as session:
                jobs.cancel(session, job_id, now=clock())

        at_once([end, stop])
        ends.append(job_of(database, job_id).state)
        assert left(database) == (0, 0, 0)
    assert set(ends) <= ({"canceled", "succeeded"} if joining else {"canceled"})


def test_a_deleted_medium_takes_the_parts_and_their_files_along(database: Database, clock: FakeClock) -> None:
    medium_id, job_id = add_ready_transfer(database)
    part_ids = split(database, job_id, 3)
    finish(database, claim(database, part_ids[0]))
    running = claim(database, part_ids[1])
    with database.write() as session:
        assert media.active_jobs(session, medium_id) == [job_id]
        assert parts.messages(session, [job_id]) == [Message(part_ids[2], "render")]
        assert parts.files_of(session, [job_id]) == [f"drawn/{part_ids[0]}"]
        assert jobs.revoke(session, job_id, now=clock())
        medium = media.get(session, medium_id)
        assert medium is not None
        media.delete(session, medium, now=clock())
    assert job_of(database, job_id).state == "canceled"
    assert left(database) == (0, 0, 0)
    assert f"drawn/{part_ids[0]}" in buried(database)
    with database.read() as session:
        assert leases.held_state(session, running) is None


def test_files_of_parts_are_named_while_their_job_lives(database: Database) -> None:
    _, part_ids = parted(database, 2)
    finish(database, claim(database, part_ids[0]))
    key = f"drawn/{part_ids[0]}"
    with database.read() as session:
        assert session.get(Tombstone, key) is None
        assert sweep.known_keys(session, [key, "drawn/other"]) == {key}


def test_a_file_that_comes_too_late_is_not_recorded(database: Database, clock: FakeClock) -> None:
    _, part_ids = parted(database, 2)
    lease = claim(database, part_ids[0])
    with pytest.raises(tombstones.LateError), database.write() as session:
        parts.finish(session, lease, [NewFile(0, "drawn/late", 1)], now=clock(), timings={})
    assert job_of(database, part_ids[0]).state == "running"


@pytest.mark.parametrize("joining", [False, True])
def test_a_part_that_finds_an_asset_lost_has_it_made_again_and_the_job_begins_anew(
    database: Database, clock: FakeClock, joining: bool
) -> None:
    medium_id, job_id = add_ready_transfer(database)
    clock.forward(5)
    part_ids = split(database, job_id, 2, medium_id)
    clock.forward(5)
    lease = claim(database, draw_all(database, part_ids) if joining else part_ids[0])
    clock.forward(5)
    with database.write() as session:
        messages = media.make_again(session, lease, {medium_id: f"asset/{medium_id}"}, now=clock())
    assert [message.queue for message in messages or ()] == ["vectorize"]
    whole = job_of(database, job_id)
    assert (whole.state, whole.waiting) == ("queued", True)
    assert left(database) == (0, 0, 0)
    again = claim(database, (messages or [])[0].job_id)
    clock.forward(5)
    with database.write() as session:
        announce(session, "asset/again")
        assert media.finish(session, again, Asset("asset/again", 1, {}, [], []), now=clock(), timings={}) is not None
        assert jobs.release(session, now=clock()) == [Message(job_id, "render")]
    # lost again: it was made for this very job, and would be so again
    clock.forward(5)
    lease = claim(database, split(database, job_id, 2, medium_id)[0])
    with database.write() as session:
        assert media.make_again(session, lease, {medium_id: "asset/again"}, now=clock()) is None


def test_the_progress_of_the_parts_is_that_of_the_job_and_never_falls(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database, 2)
    seen = [0.0]

    def told(lease: Lease, fraction: float) -> tuple[float, int]:
        clock.forward(1)
        with database.write() as session:
            assert leases.report(session, lease, Progress("render", fraction, 0, 0), now=clock())
        whole = job_of(database, job_id)
        assert (whole.stage, whole.frames_total, whole.updated_at) == ("render", 200, clock())
        assert whole.fraction >= seen[-1]
        seen.append(whole.fraction)
        return whole.fraction, whole.frames_done

    first, second = (claim(database, part_id) for part_id in part_ids)
    assert told(first, 0.5) == (0.2425, 50)
    assert told(second, 0.25) == (0.3638, 75)
    clock.forward(31)
    with database.write() as session:
        leases.reap(session, now=clock(), max_attempts=3)
    first = claim(database, part_ids[0])
    assert told(first, 0.1) == (0.3638, 75)
    assert told(first, 1.0) == (0.485, 100)  # what was drawn of the second is lost until it is taken again
    assert finish(database, first) == []
    finish(database, claim(database, part_ids[1]))
    assert job_of(database, job_id).frames_done == 200


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The wholes whose progress was told, each time that it was."""
    wholes: list[str] = []
    tell = parts.tell

    def noted(session: Session, whole_id: str, *, now: datetime) -> None:
        wholes.append(whole_id)
        tell(session, whole_id, now=now)

    monkeypatch.setattr(parts, "tell", noted)
    return wholes


def tell_of(database: Database, lease: Lease, fraction: float, stage: str = "render") -> None:
    """As a worker does."""
    with database.write() as session:
        progress = Progress(stage, fraction, 0, 0)
        assert leases.report(session, lease, progress, now=database.now(), whole_every_s=1.0)


def test_a_job_is_told_of_once_a_second_however_many_parts_it_has(
    database: Database, clock: FakeClock, told: list[str]
) -> None:
    job_id, part_ids = parted(database, 4)
    held = [claim(database, part_id) for part_id in part_ids]
    for tenths in range(1, 101):
        clock.forward(0.1)
        for number in range(4):
            if tenths % 10 == 2 * number:  # each once a second
                tell_of(database, held[number], tenths / 200)
                assert job_of(database, held[number].job_id).fraction == tenths / 200
    assert 8 <= len(told) <= 10
    assert 0.97 * 0.4 < job_of(database, job_id).fraction < 0.97 * 0.5
    # the end of a part is told at once, and all that the others have done with it
    before = len(told)
    finish(database, held[0])
    assert len(told) == before + 1
    assert job_of(database, job_id).fraction == round(0.97 * (1 + sum((96, 92, 94)) / 200) / 4, 4)
    tell_of(database, held[1], 0.6)
    assert len(told) == before + 1
    joins = [finish(database, lease) for lease in held[1:]][-1] or []
    assert (job_of(database, job_id).fraction, job_of(database, job_id).frames_done) == (0.97, 400)
    # the join is one alone
    join = claim(database, joins[0].job_id)
    tell_of(database, join, 0.5, "join")
    assert (job_of(database, job_id).stage, job_of(database, job_id).fraction) == ("join", 0.985)


def test_of_parts_that_report_at_the_same_moment_one_tells(
    database: Database, clock: FakeClock, told: list[str]
) -> None:
    for _ in range(5):
        _, part_ids = parted(database, 4)
        held = [claim(database, part_id) for part_id in part_ids]
        clock.forward(5)
        told.clear()
        at_once([partial(tell_of, database, lease, 0.5) for lease in held])
        assert len(told) == 1
        assert [job_of(database, part_id).fraction for part_id in part_ids] == [0.5] * 4


def test_after_a_clock_was_set_back_a_job_in_parts_is_told_of(
    database: Database, clock: FakeClock, told: list[str]
) -> None:
    _, part_ids = parted(database, 2)
    lease = claim(database, part_ids[0])
    clock.forward(-600)
    for fraction in (0.1, 0.2):
        tell_of(database, lease, fraction)
    assert len(told) == 1


def test_parts_do_not_expire_but_a_job_nobody_works_on_does(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database)
    clock.forward(1000)
    lease = claim(database, part_ids[0], lease_s=10_000)
    with database.write() as session:
        assert jobs.expire(session, before=clock() - timedelta(seconds=100), now=clock()) == 0
    finish(database, lease)
    clock.forward(90)
    with database.write() as session:
        assert jobs.expire(session, before=clock() - timedelta(seconds=100), now=clock()) == 0
    clock.forward(90)
    with database.write() as session:
        assert jobs.expire(session, before=clock() - timedelta(seconds=100), now=clock()) == 1
    whole = job_of(database, job_id)
    assert (whole.state, (whole.error or {})["type"]) == ("expired", "expired")
    assert left(database) == (0, 0, 0)


def test_clients_see_the_job_alone(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database)
    clock.forward(1)
    finish(database, claim(database, part_ids[0]))
    claim(database, part_ids[1])
    clock.forward(1)
    with database.write() as session:
        assert [jobs.get(session, one, owner="") is None for one in (job_id, part_ids[0])] == [False, True]
        seen = {job.id for job in jobs.page(session, "", Filter(), before=None, limit=50)}
        assert job_id in seen
        assert not seen & set(part_ids)
        assert jobs.page(session, "", Filter(ids=part_ids), before=None, limit=50) == []
        assert amounts.active_jobs(session, "") == 1
        found = statistics.collect(session, now=clock(), alive_since=clock())
        assert found.active == {("render", "running"): 1}
        assert found.parts == {"queued": 1, "running": 1}
        assert found.oldest_s == {}
        assert dict(found.ended) == {("vectorize", "succeeded"): 1}
        assert sweep.expire_jobs(session, before=clock() + timedelta(days=1)) == 0
        told = forecast.forecasts(
            session, [session.get_one(Job, job_id)], forecast.history(session), alive_since=clock()
        )
        assert told[job_id].position is None
    assert job_of(database, part_ids[0]).state == "succeeded"


def test_a_short_job_is_taken_next_and_not_behind_all_the_parts(database: Database, clock: FakeClock) -> None:
    _, part_ids = parted(database, 100)

    def take(message: str) -> fairness.Taken:
        clock.forward(1)
        with database.write() as session:
            taken = fairness.claim(session, message, now=clock(), lease_s=1000)
        assert taken is not None
        return taken

    first = take(part_ids[0])
    assert first.lease.job_id == part_ids[0]
    _, short = add_ready_transfer(database)
    clock.forward(1)
    finish(database, first.lease)
    # with one worker, on a message of the long one
    second = take(part_ids[1])
    assert (second.lease.job_id, second.deferred) == (short, Message(part_ids[1], "render"))
    # with another one that is free meanwhile
    third = take(part_ids[1])
    assert (third.lease.job_id, third.deferred) == (part_ids[1], None)
    # while one of its parts runs, others' go first; alone, it has all workers
    _, other = add_ready_transfer(database)
    assert take(part_ids[2]).lease.job_id == other
    assert [take(part_ids[k]).lease.job_id for k in (2, 3)] == part_ids[2:4]


def test_the_parts_of_two_long_jobs_are_taken_in_turn(database: Database, clock: FakeClock) -> None:
    _, first = parted(database, 4)
    clock.forward(1)
    _, second = parted(database, 4)
    messages = [*first, *second]  # in the order in which they were sent
    order = ""
    while len(order) < 8:
        clock.forward(1)
        with database.write() as session:
            taken = fairness.claim(session, messages[0], now=clock(), lease_s=1000)
        if taken is None:  # taken before, on another's message
            messages.pop(0)
            continue
        clock.forward(1)
        if job_of(database, taken.lease.job_id).kind == PartKind.JOIN:
            assert publish(database, taken.lease)
            continue
        order += "a" if taken.lease.job_id in first else "b"
        finish(database, taken.lease)
    assert order == "abababab"


def test_a_join_is_taken_before_what_else_waits(database: Database, clock: FakeClock) -> None:
    _, long = parted(database, 50)
    _, part_ids = parted(database, 2)
    join = draw_all(database, part_ids)
    with database.write() as session:
        taken = fairness.claim(session, long[0], now=clock(), lease_s=1000)
    assert taken is not None
    assert taken.lease.job_id == join


def test_keys_take_turns_whoever_has_many_parts(database: Database, clock: FakeClock) -> None:
    _, part_ids = parted(database, 10, owner="key_a")
    with database.write() as session:
        assert fairness.claim(session, part_ids[0], now=clock(), lease_s=1000) is not None
    clock.forward(1)
    _, other = add_ready_transfer(database, owner="key_b")
    with database.write() as session:
        taken = fairness.claim(session, part_ids[1], now=clock(), lease_s=1000)
    assert taken is not None
    assert taken.lease.job_id == other


def test_workers_at_the_same_moment_take_each_part_once_while_jobs_are_canceled(
    database: Database, clock: FakeClock
) -> None:
    """Claims, ends, progress and cancels from all sides: nobody waits for one who waits for him."""
    wholes = [parted(database, 6) for _ in range(3)]
    messages = [part_id for k in range(6) for _, part_ids in wholes for part_id in part_ids[k : k + 1]]
    taken, canceled = list[str](), threading.Event()

    def work(mine: list[str]) -> None:
        left_to_do = deque(mine * 3)
        while left_to_do:
            with database.write() as session:
                turn = fairness.claim(session, left_to_do.popleft(), now=clock(), lease_s=1000)
            if turn is None:
                continue
            if turn.deferred is not None:
                left_to_do.append(turn.deferred.job_id)
            taken.append(turn.lease.job_id)
            with database.write() as session:
                leases.report(session, turn.lease, Progress("render", 0.5, 1, 2), now=clock())
            is_part = job_of(database, turn.lease.job_id).kind == PartKind.PART
            assert is_part or canceled.wait(60)  # no whole ends before one of them is canceled
            if not (finish(database, turn.lease) is not None if is_part else publish(database, turn.lease)):
                with database.write() as session:
                    leases.confirm_cancel(session, turn.lease, now=clock())

    def stop() -> None:
        with database.write() as session:
            jobs.cancel(session, wholes[0][0], now=clock())
        canceled.set()

    at_once([*(partial(work, messages[k::3]) for k in range(3)), stop])
    assert len(taken) == len(set(taken))
    assert job_of(database, wholes[0][0]).state == JobState.CANCELED
    assert not set(wholes[1][1] + wholes[2][1]) - set(taken)


def test_a_part_lost_before_the_join_has_the_whole_begin_anew_as_often_as_jobs_are_tried(
    database: Database, clock: FakeClock
) -> None:
    job_id, part_ids = parted(database)
    for attempt in (1, 2):
        join = claim(database, draw_all(database, part_ids))
        with database.write() as session:
            message = leases.draw_again(session, join, now=clock(), max_attempts=3)
        assert message == Message(job_id, "render")
        whole = job_of(database, job_id)
        assert (whole.state, whole.waiting, whole.attempt, whole.published_at) == ("queued", False, attempt + 1, None)
        assert left(database) == (0, 0, 0)
        assert {f"drawn/{part_id}" for part_id in part_ids} <= buried(database)
        assert not publish(database, join)
        part_ids = split(database, job_id, 3)
    join = claim(database, draw_all(database, part_ids))
    with database.write() as session:
        assert leases.draw_again(session, join, now=clock(), max_attempts=3) is None
        assert leases.fail(session, join, PROBLEM, now=clock(), timings={})
    assert job_of(database, job_id).state == JobState.FAILED


def test_a_part_given_back_while_its_job_is_canceled_is_not_done(database: Database, clock: FakeClock) -> None:
    job_id, (first, *_) = parted(database)
    lease = claim(database, first)
    began, given = threading.Event(), threading.Event()

    def give_back() -> None:
        began.wait(60)
        with database.write() as session:
            leases.give_back(session, lease, now=clock())
        given.set()

    other = threading.Thread(target=give_back)
    other.start()
    with database.write() as session:
        assert jobs.cancel(session, job_id, now=clock())
        began.set()
        until(lambda: held_up(database) or given.is_set())
    other.join()
    with database.write() as session:
        leases.confirm_cancel(session, lease, now=clock())
    assert job_of(database, job_id).state == JobState.CANCELED
    assert left(database) == (0, 0, 0)


@pytest.mark.parametrize("canceling", [False, True])
def test_a_job_that_a_worker_which_knows_no_parts_leaves_behind_ends(
    database: Database, clock: FakeClock, canceling: bool
) -> None:
    job_id, part_ids = parted(database)
    held = [claim(database, part_id) for part_id in part_ids]
    with database.write() as session:
        if canceling:
            assert jobs.cancel(session, job_id, now=clock())
        for lease in held:  # as it ends jobs: without a look at the whole
            ended = JobState.CANCELED if canceling else JobState.FAILED
            job = session.get_one(Job, lease.job_id)
            job.state, job.lease_token, job.lease_expires_at = ended, None, None
    assert job_of(database, job_id).state == ("canceling" if canceling else "running")
    with database.write() as session:
        assert leases.reap(session, now=clock(), max_attempts=3) == []
    assert job_of(database, job_id).state == ("canceled" if canceling else "failed")
    assert left(database) == (0, 0, 0)


def test_no_join_is_made_of_less_than_all_parts(database: Database, clock: FakeClock) -> None:
    job_id, part_ids = parted(database)
    claim(database, part_ids[0])
    with database.write() as session:
        job = session.get_one(Job, part_ids[0])
        job.state, job.lease_token, job.lease_expires_at = JobState.FAILED, None, None
    assert finish(database, claim(database, part_ids[1])) == []
    assert finish(database, claim(database, part_ids[2])) == []
    whole = job_of(database, job_id)
    assert (whole.state, (whole.error or {})["type"]) == ("failed", "internal-error")
