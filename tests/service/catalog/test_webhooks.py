from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import update
from sqlalchemy.orm import Session

from service.catalog import Database, Delivery, DeliveryState, Job, JobState, keys, sweep, webhooks
from service.catalog.keys import Limits
from service.catalog.models import ENDED
from service.catalog.transitions import JOB_TRANSITIONS, Lease, LeaseCheck, Step, take_step
from service.catalog.webhooks import Attempt
from tests.service.fixtures import FakeClock, add_media, add_transfer, held_up
from tests.waiting import until

URL = "https://studio.example/hooks?token=t"
ENDS = sorted(step for step, row in JOB_TRANSITIONS.items() if row.target in ENDED)
OTHERS = sorted(step for step, row in JOB_TRANSITIONS.items() if row.target not in ENDED)


def job_in(database: Database, step: Step) -> tuple[str, Lease]:
    """A job that can take this step, and a lease that it wants."""
    row, now = JOB_TRANSITIONS[step], database.now()
    medium = add_media(database)
    job_id = add_transfer(database, medium, medium)
    lapsed = row.check is LeaseCheck.LAPSED
    expires_at = now + timedelta(seconds=-1 if lapsed else 100)
    values: dict[str, Any] = {"state": row.sources[0], "waiting": bool(row.waiting)}
    if row.check is not LeaseCheck.FREE:
        values |= {"lease_token": "t", "lease_expires_at": expires_at}
    with database.write() as session:
        session.execute(update(Job).where(Job.id == job_id).values(**values))
    return job_id, Lease(job_id, "t")


def announce(database: Database, job_id: str, url: str = URL) -> None:
    with database.write() as session:
        webhooks.announce(session, session.get_one(Job, job_id), url, now=database.now())


def deliveries(database: Database, **wanted: Any) -> list[Delivery]:
    with database.read() as session:
        return [one for one, _ in webhooks.page(session, "", before=None, limit=50, **wanted)]


def ended_job(database: Database, *urls: str) -> str:
    job_id, lease = job_in(database, Step.SUCCEED)
    for url in urls:
        announce(database, job_id, url)
    with database.write() as session:
        assert take_step(session, Step.SUCCEED, job_id, now=database.now(), lease=lease)
    return job_id


def claim(database: Database, delivery: Delivery, lease_s: float = 30) -> Attempt | None:
    with database.write() as session:
        return webhooks.claim(session, delivery.id, now=database.now(), lease_s=lease_s)


@pytest.mark.parametrize("step", ENDS)
def test_whoever_ends_a_job_makes_its_webhook_due_in_the_same_transaction(database: Database, step: Step) -> None:
    job_id, lease = job_in(database, step)
    announce(database, job_id)
    (waits,) = deliveries(database)
    assert (waits.state, waits.next_at) == (DeliveryState.WAITING, None)

    with database.write() as session:
        assert take_step(session, step, job_id, now=database.now(), lease=lease)
        session.rollback()
    assert deliveries(database)[0].state == DeliveryState.WAITING
    with database.write() as session:
        assert take_step(session, step, job_id, now=database.now(), lease=lease)
        assert not take_step(session, step, job_id, now=database.now(), lease=lease)
    (due,) = deliveries(database)
    assert (due.id, due.state, due.next_at) == (waits.id, DeliveryState.PENDING, database.now())


@pytest.mark.parametrize("step", OTHERS)
def test_no_other_step_of_a_job_makes_its_webhook_due(database: Database, step: Step) -> None:
    job_id, lease = job_in(database, step)
    announce(database, job_id)
    with database.write() as session:
        assert take_step(session, step, job_id, now=database.now(), lease=lease, lease_s=30)
    assert deliveries(database)[0].state == DeliveryState.WAITING


def test_a_receiver_is_told_of_a_jobs_end_once_and_again_when_it_is_named_after_that(database: Database) -> None:
    job_id = ended_job(database, URL, URL)
    assert [(one.url, one.state) for one in deliveries(database)] == [(URL, "pending")]
    announce(database, job_id, f"{URL}2")
    announce(database, job_id)
    announce(database, job_id)
    told = [(one.url, one.state) for one in deliveries(database)]
    assert told == [(URL, "pending"), (URL, "pending"), (f"{URL}2", "pending"), (URL, "pending")]
    assert {one.origin for one in deliveries(database)} == {"https://studio.example"}


def test_two_who_name_a_receiver_at_the_same_time_have_it_told_once(database: Database) -> None:
    job_id, _ = job_in(database, Step.SUCCEED)
    with ThreadPoolExecutor(1) as others:
        with database.write() as session:
            webhooks.announce(session, session.get_one(Job, job_id), URL, now=database.now())
            session.flush()
            other = others.submit(announce, database, job_id)
            until(lambda: held_up(database) == 1)  # it has asked before this one is recorded
            assert not other.done()
        other.result(60)
    assert [one.state for one in deliveries(database)] == [DeliveryState.WAITING]


def test_of_two_who_claim_a_delivery_one_has_it_and_a_late_one_changes_nothing(
    database: Database, clock: FakeClock
) -> None:
    ended_job(database, URL)
    (delivery,) = deliveries(database)
    first = claim(database, delivery)
    assert first is not None
    assert claim(database, delivery) is None
    with database.read() as session:
        assert webhooks.due(session, now=clock(), limit=9) == []
    clock.forward(31)
    second = claim(database, delivery)
    assert second is not None
    assert (first.delivery.id, first.number, second.number) == (second.delivery.id, 1, 2)
    with database.write() as session:
        assert not webhooks.missed(session, first, now=clock(), retry_s=None, status=500, error="late")
        assert webhooks.succeeded(session, second, 204, now=clock())
        assert not webhooks.succeeded(session, first, 204, now=clock())
    (told,) = deliveries(database)
    assert (told.state, told.last_status, told.delivered_at) == (DeliveryState.DELIVERED, 204, clock())


def test_two_who_claim_the_same_deliveries_in_another_order_do_not_wait_for_each_other(database: Database) -> None:
    """Each had what the other one waited for: a deadlock on PostgreSQL, with more than one API."""
    ended_job(database, URL, f"{URL}&other")
    one, other = deliveries(database)
    with database.write() as session:
        webhooks.secret(session, "", now=database.now())  # who makes it is waited for
    taken: list[str] = []

    def take(session: Session, *wanted: Delivery) -> None:
        now = database.now()
        claimed = [webhooks.claim(session, each.id, now=now, lease_s=30) for each in wanted]
        taken.extend(attempt.delivery.id for attempt in claimed if attempt is not None)

    def take_both() -> None:
        with database.write() as session:
            take(session, other, one)

    with ThreadPoolExecutor() as threads:
        with database.write() as session:
            take(session, one)
            second = threads.submit(take_both)
            until(lambda: second.done() or held_up(database) == 1)
            take(session, other)
        second.result()
    assert sorted(taken) == sorted([one.id, other.id])


def test_what_is_due_can_leave_out_origins_and_owners(database: Database) -> None:
    ended_job(database, "https://a.example/1", "https://b.example:444/1")
    with database.read() as session:
        of_all = webhooks.due(session, now=database.now(), limit=9)
        but_a = webhooks.due(
            session, now=database.now(), limit=9, not_to={("", "https://a.example"), ("key_x", "https://b.example:444")}
        )
        assert webhooks.due(session, now=database.now(), limit=9, not_of={""}) == []
    assert [one.origin for one in of_all] == ["https://a.example", "https://b.example:444"]
    assert [one.origin for one in but_a] == ["https://b.example:444"]


def test_many_that_are_due_of_one_owner_hide_no_other(database: Database, clock: FakeClock) -> None:
    for owner, number in (("key_a", 5), ("key_b", 2), ("key_c", 1)):
        clock.forward(1)
        ended_job(database, *(f"{URL}{owner}{one}" for one in range(number)))
        with database.write() as session:
            session.execute(update(Delivery).where(Delivery.owner == "").values(owner=owner))
    with database.read() as session:
        found = webhooks.due(session, now=clock(), limit=5)
    assert [one.owner for one in found] == ["key_a", "key_b", "key_c", "key_a", "key_b"]


def test_a_webhook_that_was_recorded_while_its_job_ended_is_woken_later(database: Database) -> None:
    job_id, _ = job_in(database, Step.SUCCEED)
    announce(database, job_id)
    with database.write() as session:  # as one sees it whose transaction began before the job's end
        session.execute(update(Job).where(Job.id == job_id).values(state=JobState.SUCCEEDED))
    with database.write() as session:
        assert webhooks.wake(session, now=database.now()) == 1
        assert webhooks.wake(session, now=database.now()) == 0
    assert deliveries(database)[0].state == DeliveryState.PENDING


def test_a_delivery_is_replayed_with_its_id_unless_its_job_goes_on(database: Database, clock: FakeClock) -> None:
    job_id, lease = job_in(database, Step.SUCCEED)
    announce(database, job_id)
    (delivery,) = deliveries(database)
    with database.write() as session:
        assert not webhooks.replay(session, delivery.id, now=clock())
        assert take_step(session, Step.SUCCEED, job_id, now=clock(), lease=lease)
    attempt = claim(database, delivery)
    assert attempt is not None
    with database.write() as session:
        assert webhooks.missed(session, attempt, now=clock(), retry_s=None, status=410, error="gone")
    assert deliveries(database)[0].state == DeliveryState.FAILED
    with database.write() as session:
        assert webhooks.replay(session, delivery.id, now=clock())
    (again,) = deliveries(database)
    assert (again.id, again.state, again.attempts, again.next_at) == (delivery.id, "pending", 0, clock())


def test_a_delivery_that_is_replayed_while_it_is_attempted_is_attempted_anew(
    database: Database, clock: FakeClock
) -> None:
    ended_job(database, URL)
    (delivery,) = deliveries(database)
    attempt = claim(database, delivery)
    assert attempt is not None
    clock.forward(1)
    with database.write() as session:
        assert webhooks.replay(session, delivery.id, now=clock())
        assert not webhooks.missed(session, attempt, now=clock(), retry_s=None, status=500, error="the last")
    (again,) = deliveries(database)
    assert (again.state, again.attempts, again.next_at) == (DeliveryState.PENDING, 0, clock())
    anew = claim(database, delivery)
    assert anew is not None
    assert anew.number == 1


def test_a_webhook_goes_away_with_its_job(database: Database, clock: FakeClock) -> None:
    ended_job(database, URL)
    clock.forward(100)
    with database.write() as session:
        assert sweep.expire_jobs(session, before=clock()) == 1
    assert deliveries(database) == []


def test_pages_are_of_one_owner_and_can_be_of_a_state_or_a_job(database: Database) -> None:
    first = ended_job(database, URL, f"{URL}2")
    job_id, _ = job_in(database, Step.SUCCEED)
    announce(database, job_id)
    assert [one.job_id for one in deliveries(database)] == [job_id, first, first]
    assert [one.job_id for one in deliveries(database, states=["waiting"])] == [job_id]
    assert [one.url for one in deliveries(database, job_id=first)] == [f"{URL}2", URL]
    with database.read() as session:
        assert webhooks.page(session, "key_x", before=None, limit=9) == []
        assert webhooks.get(session, deliveries(database)[0].id, owner="key_x") is None


def test_what_a_key_takes_over_takes_its_webhooks_along(database: Database) -> None:
    ended_job(database, URL)
    with database.write() as session:
        key, _ = keys.create(session, "studio", Limits(), now=database.now())
        keys.adopt(session, key, owner="")
    assert deliveries(database) == []
    with database.read() as session:
        assert [one.url for one, _ in webhooks.page(session, key.id, before=None, limit=9)] == [URL]


def test_a_replaced_secret_signs_for_a_day_more(database: Database, clock: FakeClock) -> None:
    def now() -> tuple[str, ...]:
        with database.write() as session:
            return webhooks.signing_secrets(session, "", now=clock())

    (first,) = now()
    assert now() == (first,)
    with database.write() as session:
        second = webhooks.rotate(session, "", now=clock()).secret
        assert webhooks.secret(session, "key_x", now=clock()).secret not in {first, second}
    clock.forward(webhooks.FORMER_SECRET_S - 1)
    assert now() == (second, first)
    clock.forward(2)
    assert now() == (second,)


def test_every_replaced_secret_signs_for_as_long_as_was_promised(database: Database, clock: FakeClock) -> None:
    """Also when another replaces the next one meanwhile, and then as many as there is room for."""

    def now() -> tuple[str, ...]:
        with database.write() as session:
            return webhooks.signing_secrets(session, "", now=clock())

    def rotate() -> str:
        with database.write() as session:
            return webhooks.rotate(session, "", now=clock()).secret

    made = [*now()]
    for _ in range(webhooks.FORMER_SECRETS):
        made.append(rotate())
        clock.forward(3600)
        assert now() == tuple(reversed(made))
    with pytest.raises(webhooks.TooManySecretsError) as caught:
        rotate()
    first_ends = clock() + timedelta(seconds=webhooks.FORMER_SECRET_S - 3600 * webhooks.FORMER_SECRETS)
    assert caught.value.until == first_ends
    assert now() == tuple(reversed(made))
    clock.forward((first_ends - clock()).total_seconds() - 1)
    assert now() == tuple(reversed(made))
    clock.forward(1)
    assert now() == tuple(reversed(made[1:]))
    made.append(rotate())
    assert now() == tuple(reversed(made[1:]))
    clock.forward(webhooks.FORMER_SECRET_S)
    assert now() == (made[-1],)
