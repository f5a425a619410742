from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

import pytest

from service.catalog import Database, JobKind, VectorizeRequest, fairness, jobs, leases
from service.catalog.fairness import Taken
from service.catalog.models import Role
from tests.promises import Drill
from tests.service.fixtures import FakeClock, held_up, job_of
from tests.side_by_side import at_once
from tests.waiting import until

MANY = 40


def queue_jobs(database: Database, owner: str, number: int) -> list[str]:
    """Queued and published jobs of an owner."""
    with database.write() as session:
        made = [
            jobs.create(
                session, JobKind.VECTORIZE, request=VectorizeRequest(Role.VIDEO), now=database.now(), owner=owner
            )
            for _ in range(number)
        ]
        for job in made:
            jobs.mark_published(session, job.id, now=database.now())
    return [job.id for job in made]


class Worker:
    """Takes messages one after the other, as a worker does; each job takes a second of the clock."""

    def __init__(self, database: Database, clock: FakeClock, messages: deque[str]) -> None:
        self.database, self.clock, self.messages = database, clock, messages

    def take(self) -> Taken | None:
        """The next job that a message leads to."""
        while self.messages:
            message = self.messages.popleft()
            with self.database.write() as session:
                turn = fairness.claim(session, message, now=self.clock(), lease_s=1000)
            if turn is not None:
                if turn.deferred is not None:
                    self.messages.append(turn.deferred.job_id)
                return turn
        return None

    def finish(self, turn: Taken) -> None:
        self.clock.forward(1)
        with self.database.write() as session:
            assert leases.succeed(session, turn.lease, now=self.clock(), timings={})


def owner_of(database: Database, turn: Taken | None) -> str:
    assert turn is not None
    job = job_of(database, turn.lease.job_id)
    return job.owner


def test_an_owners_jobs_go_as_they_were_queued_whatever_the_order_of_messages(
    database: Database, clock: FakeClock
) -> None:
    ids = queue_jobs(database, "", 4)
    worker = Worker(database, clock, deque([ids[3], ids[0], ids[0], ids[2], ids[1]]))
    taken = [worker.take() for _ in range(5)]
    assert [turn and turn.lease.job_id for turn in taken] == [*ids, None]


def test_messages_in_order_are_not_sent_again(database: Database, clock: FakeClock) -> None:
    ids = queue_jobs(database, "", 4)
    worker = Worker(database, clock, deque(ids))
    taken = [worker.take() for _ in range(4)]
    assert all(turn is not None and turn.deferred is None for turn in taken)


def test_turns_of_several_keys_leave_each_keys_jobs_in_their_order(database: Database, clock: FakeClock) -> None:
    """A message is sent again, behind all others, where it came in another key's turn: its job came last of its key."""
    mine, others = queue_jobs(database, "key_a", 6), queue_jobs(database, "key_b", 4)
    worker = Worker(database, clock, deque([*mine, *others]))
    running, order = deque([worker.take(), worker.take()]), list[str]()
    while running:
        if (turn := running.popleft()) is not None:
            order.append(turn.lease.job_id)
            worker.finish(turn)
            running.append(worker.take())
    assert [job for job in order if job in mine] == mine
    assert [job for job in order if job in others] == others


@pytest.mark.parametrize("workers", [1, 2])
def test_many_jobs_of_one_key_hold_up_anothers_by_one(database: Database, clock: FakeClock, workers: int) -> None:
    messages = deque(queue_jobs(database, "key_a", MANY))
    worker = Worker(database, clock, messages)
    running = deque(worker.take() for _ in range(workers))
    clock.forward(1)
    (late,) = queue_jobs(database, "key_b", 1)
    messages.append(late)  # the last of all messages
    first = running.popleft()
    assert first is not None
    worker.finish(first)
    turn = worker.take()
    assert turn is not None
    assert turn.lease.job_id == late
    assert turn.deferred is not None
    running.append(turn)
    # and every job of the first is done, once
    done = 1
    while running:
        if (one := running.popleft()) is None:
            continue
        worker.finish(one)
        done += 1
        running.append(worker.take())
    assert done == MANY + 1


def test_keys_take_turns_and_every_job_keeps_a_message(
    database: Database, clock: FakeClock, promise: Callable[..., Drill]
) -> None:
    drill = promise("R12", wanted="fair between keys")
    messages = deque(queue_jobs(database, "key_a", 6) + queue_jobs(database, "key_b", 3) + queue_jobs(database, "", 3))
    worker = Worker(database, clock, messages)
    order = []
    while (turn := worker.take()) is not None:
        order.append(owner_of(database, turn))
        if turn.deferred is not None:
            named = job_of(database, turn.deferred.job_id)
            assert (named.state, named.published_at) == ("queued", None)  # the reaper sends it if the worker cannot
        worker.finish(turn)
    assert len(order) == 12
    assert [sorted(order[i : i + 3]) for i in (0, 3, 6)] == [["", "key_a", "key_b"]] * 3
    assert order[9:] == ["key_a"] * 3
    drill.measured = "6, 3 and 3 jobs of three keys: each in turn until its jobs are done"


def test_the_owner_with_the_fewest_running_goes_first(database: Database, clock: FakeClock) -> None:
    worker = Worker(database, clock, deque(queue_jobs(database, "key_a", 3)))
    first, second = worker.take(), worker.take()
    assert owner_of(database, first) == owner_of(database, second) == "key_a"
    clock.forward(1)
    worker.messages.extend(queue_jobs(database, "key_b", 2))
    assert [owner_of(database, worker.take()) for _ in range(2)] == ["key_b", "key_b"]


def test_messages_of_ended_jobs_lead_to_nothing(database: Database, clock: FakeClock) -> None:
    canceled, other = queue_jobs(database, "key_a", 1) + queue_jobs(database, "key_b", 1)
    with database.write() as session:
        assert jobs.cancel(session, canceled, now=clock())
    worker = Worker(database, clock, deque([canceled, "job_unknown", other]))
    turn = worker.take()
    assert turn is not None
    assert (turn.lease.job_id, turn.deferred) == (other, None)


def test_workers_at_the_same_moment_take_each_job_once(database: Database, clock: FakeClock) -> None:
    ids = queue_jobs(database, "key_a", 12) + queue_jobs(database, "key_b", 4)
    messages, taken = deque(ids), list[str]()

    def work() -> None:
        worker = Worker(database, clock, messages)
        while True:
            try:
                turn = worker.take()
            except IndexError:  # another thread had the last message
                turn = None
            if turn is None:
                return
            taken.append(turn.lease.job_id)
            with database.write() as session:
                leases.succeed(session, turn.lease, now=clock(), timings={})

    at_once([work] * 4)
    while (turn := Worker(database, clock, messages).take()) is not None:  # whose message was on its way at the end
        taken.append(turn.lease.job_id)
    assert sorted(taken) == sorted(ids)


def test_workers_that_choose_at_the_same_moment_do_not_block_each_other(database: Database, clock: FakeClock) -> None:
    """One that lost its choice kept the locks of that try while it took others: a deadlock on PostgreSQL."""
    mine, (chosen,) = queue_jobs(database, "key_a", 2), queue_jobs(database, "key_b", 1)
    running, first, last = mine[0], mine[1], queue_jobs(database, "key_a", 1)[0]
    with database.write() as session:
        assert leases.claim(session, running, now=clock(), lease_s=1000)
    taken: dict[str, str | None] = {}

    def take(named: str) -> None:
        with database.write() as session:
            turn = fairness.claim(session, named, now=clock(), lease_s=1000)
        taken[named] = None if turn is None else turn.lease.job_id

    threads = [threading.Thread(target=take, args=(named,)) for named in (last, first)]
    with database.write() as session:
        turn = fairness.claim(session, chosen, now=clock(), lease_s=1000)
        assert turn is not None
        for count, thread in enumerate(threads, 1):
            thread.start()
            until(lambda wanted=count: held_up(database) == wanted, 10)
    for thread in threads:
        thread.join()
    assert turn.lease.job_id == chosen
    assert taken == {last: first, first: None}
