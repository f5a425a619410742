"""The deliverer against receivers that are servers, with a clock that is moved by hand."""

from __future__ import annotations

import json
import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select, update

from service.catalog import Database, Delivery, Job, leases, webhooks
from service.catalog.transitions import Step
from service.catalog.webhooks import Attempt, Due
from service.egress import Egress
from service.errors import stored_problem
from service.resolving import RESOLVERS
from service.settings import Settings
from service.webhooks.deliverer import CONCURRENCY, PER_ORIGIN, RETRIES_S, Deliverer
from tests.service.catalog.test_webhooks import announce, deliveries, ended_job, job_in
from tests.service.fixtures import FakeClock
from tests.service.receivers import Receiver
from tests.service.servers import free_port
from tests.side_by_side import at_once
from tests.waiting import until

DAY_S = 86_400


@pytest.fixture
def deliverer(database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Deliverer]:
    # a receiver that hangs does so until its test is over
    monkeypatch.setattr("service.egress._HEAD_S", 120.0)
    settings = Settings(
        data_dir=tmp_path / "data", allow_private_networks=True, webhook_timeout_s=120, body_timeout_s=120
    )
    egress = Egress(settings)
    made = Deliverer(settings, database, egress)
    yield made
    until(lambda: not made.busy)  # an attempt uses the database, which is closed next
    egress.close()


def attempt_all(deliverer: Deliverer) -> int:
    """Attempt what is due, until nothing is; how many attempts there were."""
    attempts = 0
    while begun := deliverer.round():
        attempts += begun
        until(lambda: not deliverer.busy)
    return attempts


def secret_of(database: Database) -> str:
    with database.write() as session:
        return webhooks.secret(session, "", now=database.now()).secret


def only(database: Database) -> Delivery:
    (one,) = deliveries(database)
    return one


def test_two_who_make_the_first_secrets_of_owners_do_not_wait_for_each_other(
    deliverer: Deliverer, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each had made the one that the other wanted next: a deadlock on PostgreSQL, with more than one API."""
    due = []
    for owner in ("key_a", "key_b"):
        ended_job(database, "https://a.example/1", "https://b.example/1")
        due.append([Due(one.id, owner, one.origin) for one in deliveries(database)])
        with database.write() as session:
            for table in (Job, Delivery):
                session.execute(update(table).where(table.owner == "").values(owner=owner))
    (first_a, second_a), (first_b, second_b) = due
    claim, both, begun = webhooks.claim, threading.Barrier(2), threading.local()

    def claims(*arguments: Any, **options: Any) -> Attempt | None:
        if hasattr(begun, "one"):  # the other one has begun too, unless it waits
            with suppress(threading.BrokenBarrierError):
                both.wait(1)
        begun.one = True
        return claim(*arguments, **options)

    monkeypatch.setattr(webhooks, "claim", claims)
    first, second = [first_a, first_b], [second_b, second_a]
    claimed = at_once([lambda: deliverer._claim(first), lambda: deliverer._claim(second)])
    assert [{one.delivery.id for one in each} for each in claimed] == [
        {one.delivery_id for one in each} for each in (first, second)
    ]


def test_a_receiver_learns_of_a_job_and_can_trust_what_it_learns(
    database: Database, deliverer: Deliverer, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    with Receiver().listening() as receiver:
        job_id = ended_job(database, receiver.url)
        assert attempt_all(deliverer) == 1
        assert attempt_all(deliverer) == 0
    (arrived,) = receiver.got
    said = arrived.verified(secret_of(database))
    assert said["type"] == "job.succeeded"
    assert {name: said["data"][name] for name in ("id", "state", "kind", "url", "error", "metadata")} == {
        "id": job_id,
        "state": "succeeded",
        "kind": "transfer",
        "url": f"/v1/jobs/{job_id}",
        "error": None,
        "metadata": {},
    }
    assert said["data"]["looks"][0]["video"].startswith("vid_")
    assert said["timestamp"] == said["data"]["finished_at"]
    assert arrived.id == only(database).id
    assert arrived.headers["content-type"] == "application/json"
    assert only(database).state == "delivered"
    # httpx names the URL, and is silenced in the service (`service.logs`)
    logged = " ".join(
        f"{record.getMessage()} {record.__dict__}" for record in caplog.records if "http" not in record.name
    )
    assert arrived.id in logged  # it is the id that is logged, not the URL and not the message
    assert "not-for-logs" not in logged
    assert secret_of(database) not in logged


def test_a_failure_says_why_as_the_job_itself_does(database: Database, deliverer: Deliverer) -> None:
    job_id, lease = job_in(database, Step.FAIL)
    with Receiver().listening() as receiver:
        announce(database, job_id, receiver.url)
        with database.write() as session:
            error = stored_problem("no-face", "no face found")
            assert leases.fail(session, lease, error, now=database.now(), timings={})
        assert attempt_all(deliverer) == 1
    (arrived,) = receiver.got
    said = arrived.verified(secret_of(database))
    assert (said["type"], said["data"]["url"]) == ("job.failed", f"/v1/jobs/{job_id}")
    assert (said["data"]["error"]["code"], said["data"]["error"]["type"]) == ("no-face", "/docs/problems#no-face")


def test_a_receiver_that_fails_is_told_again_over_a_day_with_the_same_id_and_message(
    database: Database, deliverer: Deliverer, clock: FakeClock
) -> None:
    began = clock()
    with Receiver(answers=(500,)).listening() as receiver:
        ended_job(database, receiver.url)
        while (now := only(database)).state == "pending":
            assert now.next_at is not None
            clock.forward(max(0.0, (now.next_at - clock()).total_seconds()))
            assert attempt_all(deliverer) == 1
    assert only(database).state == "failed"
    assert (only(database).last_status, only(database).last_error) == (500, "answered with status 500")
    assert len(receiver.got) == len(RETRIES_S) + 1
    assert len({(one.id, one.body) for one in receiver.got}) == 1
    assert DAY_S <= (clock() - began).total_seconds() <= DAY_S * 1.11
    clock.forward(10 * DAY_S)
    assert attempt_all(deliverer) == 0


def test_one_that_says_gone_is_left_alone(database: Database, deliverer: Deliverer) -> None:
    with Receiver(answers=(410,)).listening() as receiver:
        ended_job(database, receiver.url)
        attempt_all(deliverer)
    assert (only(database).state, only(database).attempts) == ("failed", 1)


def test_a_redirect_is_a_failure_and_is_not_followed(database: Database, deliverer: Deliverer) -> None:
    with Receiver().listening() as other, Receiver(answers=(307,), location=other.url).listening() as receiver:
        ended_job(database, receiver.url)
        attempt_all(deliverer)
    assert (len(receiver.got), len(other.got)) == (1, 0)
    assert (only(database).state, only(database).last_error) == ("pending", "redirects are not followed")


@pytest.mark.parametrize(("status", "place"), [(304, "/other"), (300, "/other"), (302, "")])
def test_what_leads_nowhere_is_told_as_what_it_is(
    database: Database, deliverer: Deliverer, status: int, place: str
) -> None:
    with Receiver(answers=(status,), location=place).listening() as receiver:
        ended_job(database, receiver.url)
        attempt_all(deliverer)
    assert (only(database).state, only(database).last_status) == ("pending", status)
    assert only(database).last_error == f"answered with status {status}"


def test_a_receiver_that_is_down_is_told_once_it_is_back(
    database: Database, deliverer: Deliverer, clock: FakeClock
) -> None:
    receiver = Receiver(port=free_port())
    ended_job(database, receiver.url)
    attempt_all(deliverer)
    assert (only(database).state, only(database).last_status) == ("pending", None)
    clock.forward(4)
    assert attempt_all(deliverer) == 0
    clock.forward(2)
    with receiver.listening():
        assert attempt_all(deliverer) == 1
    assert only(database).state == "delivered"


def test_what_cannot_be_sent_for_a_fault_of_our_own_has_an_end(
    database: Database, deliverer: Deliverer, clock: FakeClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> bytes:
        raise KeyError("a job that cannot be told")

    monkeypatch.setattr("service.webhooks.deliverer.payload", fail)
    ended_job(database, "https://receiver.test/")
    for attempts in range(1, len(RETRIES_S) + 2):
        assert attempt_all(deliverer) == 1
        assert (only(database).attempts, only(database).last_status) == (attempts, None)
        clock.forward(DAY_S)
    assert (only(database).state, only(database).last_error) == ("failed", "could not be sent: an error of the service")


def test_nothing_is_sent_into_private_networks(database: Database, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data")
    guarded = Deliverer(settings, database, Egress(settings))
    with Receiver().listening() as receiver:
        ended_job(database, receiver.url)
        assert attempt_all(guarded) == 1
    assert receiver.got == []
    assert (only(database).state, only(database).last_error) == (
        "pending",
        "the host of the URL is not at a public address",
    )


def test_a_receiver_that_hangs_holds_up_no_other(database: Database, deliverer: Deliverer, clock: FakeClock) -> None:
    hanging = Receiver(hangs=1000)
    with Receiver().listening() as fine, hanging.listening():
        # more that are due before the others than are looked at in one round
        for _ in range(CONCURRENCY * 5):
            ended_job(database, hanging.url)
        clock.forward(1)
        told = {ended_job(database, fine.url) for _ in range(10)}
        deliverer.start()
        fine.wait_for(len(told))
        hanging.wait_for(PER_ORIGIN)
        # all of them, while the other has not answered a single one
        assert {json.loads(one.body)["data"]["id"] for one in fine.got} == told
        assert deliveries(database, states=["failed"]) == []
        assert hanging.most == len(hanging.got) == PER_ORIGIN
        deliverer.stop()


def give(database: Database, owner: str, *, apart: bool = False) -> None:
    """Have an owner own what is nobody's; ``apart``: as if each were to a receiver of its own."""
    with database.write() as session:
        for number, one in enumerate(session.scalars(select(Delivery).where(Delivery.owner == "")).all()):
            one.owner = owner
            one.origin = f"https://{owner}-{number}.example" if apart else one.origin


def test_two_keys_whose_receivers_all_hang_hold_up_no_third(
    database: Database, deliverer: Deliverer, clock: FakeClock
) -> None:
    hanging = Receiver(hangs=1000)
    with Receiver().listening() as fine, hanging.listening():
        for owner in ("key_a", "key_b"):
            for _ in range(CONCURRENCY * 3):
                ended_job(database, hanging.url)
            give(database, owner, apart=True)
        while deliverer.round():
            pass
        assert CONCURRENCY // 2 < deliverer.busy < CONCURRENCY
        clock.forward(1)
        ended_job(database, fine.url)
        give(database, "key_c")
        assert deliverer.round() == 1
        fine.wait_for(1)


def test_a_receiver_that_hangs_for_one_key_is_asked_for_another(database: Database, deliverer: Deliverer) -> None:
    with Receiver(hangs=PER_ORIGIN).listening() as receiver:
        for _ in range(PER_ORIGIN + 1):
            ended_job(database, receiver.url)
        give(database, "key_a")
        assert deliverer.round() == PER_ORIGIN
        receiver.wait_for(PER_ORIGIN)
        ended_job(database, receiver.url)
        give(database, "key_b")
        assert deliverer.round() == 1
        receiver.wait_for(PER_ORIGIN + 1)
        assert receiver.most == PER_ORIGIN + 1


def test_when_there_is_no_thread_the_places_come_free_and_it_is_told_later(
    database: Database, deliverer: Deliverer, clock: FakeClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_thread(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with Receiver().listening() as receiver:
        ended_job(database, receiver.url)
        with monkeypatch.context() as patch:
            patch.setattr(threading.Thread, "start", no_thread)
            with pytest.raises(RuntimeError):
                deliverer.round()
        assert deliverer.busy == 0
        clock.forward(150)
        assert attempt_all(deliverer) == 1
        assert len(receiver.got) == 1


def test_what_a_service_that_stops_has_not_asked_for_costs_no_attempt(
    database: Database, deliverer: Deliverer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    asked, told, real = threading.Semaphore(0), threading.Event(), socket.getaddrinfo

    def hanging(host: str, *args: Any, flags: int = 0, **kwargs: Any) -> Any:
        if flags & socket.AI_NUMERICHOST:
            return real(host, *args, flags=flags, **kwargs)
        asked.release()
        assert told.wait(60)
        raise socket.gaierror(socket.EAI_NONAME, "no such name")

    with Receiver(answers=(500,)).listening() as receiver:  # attempted once before, which stays as it is
        ended_job(database, receiver.url)
        attempt_all(deliverer)
    before = only(database)
    assert (before.attempts, before.last_error) == (1, "answered with status 500")
    with database.write() as session:
        for one in session.scalars(select(Delivery)):
            one.url, one.next_at = "http://waiting.example/", database.now()
    monkeypatch.setattr(socket, "getaddrinfo", hanging)
    lookups = [
        deliverer._egress._resolver.look_up(f"key_{number}", f"{number}.example", 80) for number in range(RESOLVERS)
    ]
    for _ in lookups:
        assert asked.acquire(timeout=60)
    caplog.clear()
    assert deliverer.round() == 1  # its name waits for its turn
    until(lambda: len(deliverer._egress._resolver._waiting) == 1)
    deliverer._egress.close()
    until(lambda: not deliverer.busy)
    after = only(database)
    assert (after.state, after.attempts, after.last_error) == ("pending", 1, "answered with status 500")
    # and one that is begun after that
    assert deliverer.round() == 1
    until(lambda: not deliverer.busy)
    assert (only(database).attempts, only(database).lease_token) == (1, None)
    assert [record for record in caplog.records if record.levelname in {"WARNING", "ERROR"}] == []
    told.set()


def test_two_processes_that_deliver_tell_a_receiver_once(database: Database, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", allow_private_networks=True)
    pair = [Deliverer(settings, database, Egress(settings)) for _ in range(2)]
    with Receiver().listening() as receiver:
        for _ in range(20):
            ended_job(database, receiver.url)
        for one in pair:
            one.start()
        until(lambda: len(deliveries(database, states=["delivered"])) == 20)
        for one in pair:
            one.stop()
    assert len(receiver.got) == len({one.id for one in receiver.got}) == 20


def test_what_keeps_it_from_working_is_one_line_however_long_it_lasts(
    database: Database, deliverer: Deliverer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("service.webhooks.deliverer.POLL_S", 0.01)
    tries = 0
    begin = deliverer.round

    def failing_at_first() -> int:
        nonlocal tries
        tries += 1
        if tries < 20:
            raise OSError("the disk is full")
        return begin()

    monkeypatch.setattr(deliverer, "round", failing_at_first)
    with Receiver().listening() as receiver:
        ended_job(database, receiver.url)
        deliverer.start()
        receiver.wait_for(1)
        deliverer.stop()
    said = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert said == ["webhooks cannot be delivered for now"]
