"""Brokers and workers that die, with two APIs and two workers of one slot each: R1, R3, R4."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
import redis

from scripts.samples import Samples
from service.queue.broker import QUEUES
from tests.promises import Drill
from tests.service.receivers import Receiver
from tests.service.s3 import S3
from tests.service.servers import free_port, fresh_database, redis_server
from tests.waiting import until
from tests.worker.serving import Service, pool_child, running_scaled, running_service

#: shorter times than a service has by default (lease 30 s, rounds of the reaper 10 s), so that the drills are short
QUICK = {
    **{"lease_s": "8", "heartbeat_s": "1", "reap_interval_s": "1", "republish_after_s": "1"},
    "allow_private_networks": "true",  # receivers of webhooks are on this machine
}
AT = "at a lease of 8 s and a round a second"


class Broker:
    """A Redis server that can be stopped, and started again at the same port without what it held."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port, self._stack = folder, free_port(), ExitStack()
        self.url = self.start()

    def start(self) -> str:
        return self._stack.enter_context(redis_server(self._folder, self._port))

    def stop(self) -> None:
        self._stack.close()

    def wipe(self, at_least: int) -> int:
        """Forget everything if there are so many messages; how many there were, 0 when there are fewer."""
        with redis.Redis(port=self._port) as client:
            held = self.messages()
            if held < at_least:
                return 0
            client.flushall()
        return held

    def messages(self) -> int:
        """How many messages wait for a worker."""
        with redis.Redis(port=self._port) as client:
            return sum(int(client.llen(name)) for name in QUEUES)


@dataclass(frozen=True)
class Scaled:
    service: Service
    broker: Broker


@pytest.fixture(scope="module")
def scaled(postgres_url: str, s3: S3, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scaled]:
    folder = tmp_path_factory.mktemp("scaled")
    broker = Broker(folder)
    with (
        fresh_database(postgres_url) as url,
        s3.fresh_bucket() as bucket,
        running_scaled(folder, database_url=url, broker_url=broker.url, s3=bucket, previews=0, **QUICK) as service,
    ):
        yield Scaled(service, broker)
    broker.stop()


@pytest.fixture(params=[pytest.param("embedded", marks=pytest.mark.slow), "scaled"])
def service(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Service]:
    if request.param == "scaled":
        yield request.getfixturevalue("scaled").service
        return
    with running_service(tmp_path, worker_concurrency="1", **QUICK) as running:
        yield running


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with Receiver().listening() as listening:
        yield listening


def test_a_job_whose_process_is_killed_succeeds_on_its_second_attempt(
    service: Service, samples: Samples, receiver: Receiver, promise: Callable[..., Drill]
) -> None:
    drill = promise("R1", wanted="attempt 2 succeeds within 60 s + the work; one webhook")
    medium = service.upload("/videos", samples.woman_clip, webhook=receiver.url)
    service.at_work(medium["job"])
    os.kill(pool_child(service, medium["job"]), signal.SIGKILL)
    began = time.monotonic()
    until(lambda: service.job(medium["job"])["attempt"] == 2, 240)
    again = time.monotonic() - began
    job = service.finished(medium["job"])
    receiver.wait_for(1)
    told = f"{len(receiver.got)} webhook"
    drill.measured = f"attempt {job['attempt']} began after {again:.1f} s and {job['state']} ({AT}); {told}"
    drill.keep_to(again, 60)
    assert (job["state"], job["attempt"]) == ("succeeded", 2)
    assert len(service.client.get("/videos").json()["data"]) == 1
    until(lambda: not service.drafts())
    assert service.client.delete(f"/videos/{medium['id']}").status_code == 204
    assert [json.loads(one.body)["data"]["id"] for one in receiver.got] == [job["id"]]


def two_at_work(service: Service, clip: Path) -> list[str]:
    """Jobs that take the only slot of either worker: all of a video, twice (of a reference a few frames are enough)."""
    jobs: list[str] = [service.upload("/videos", clip, matching=matching)["job"] for matching in ("table", "chain")]
    for job in jobs:
        service.at_work(job)
    return jobs


def test_busy_workers_outlive_their_broker(scaled: Scaled, samples: Samples, promise: Callable[..., Drill]) -> None:
    """Their only slots are taken while Redis goes away, so that nothing but the acknowledgement can tell them."""
    drill = promise("R3", wanted="running job not aborted; POST during the outage 202; no job lost")
    service = scaled.service
    running = two_at_work(service, samples.woman_clip)
    scaled.broker.stop()
    gone = time.monotonic()
    later = service.upload("/references", samples.portrait)  # taken while the broker is away
    done = [service.finished(job, 240) for job in running]
    assert {(job["state"], job["attempt"]) for job in done} == {("succeeded", 1)}
    assert service.client.get(f"/jobs/{later['job']}").json()["state"] == "queued"
    time.sleep(3)  # the acknowledgement fails
    scaled.broker.start()
    away = time.monotonic() - gone
    assert service.finished(later["job"])["state"] == "succeeded"
    drill.measured = f"away for {away:.0f} s: running jobs on attempt 1, POST 202, all three succeeded"


def sent_again(service: Service) -> int:
    return sum(int(line["count"]) for line in service.events("publishing again"))


def test_what_a_wiped_broker_forgot_is_sent_again(
    scaled: Scaled, samples: Samples, promise: Callable[..., Drill]
) -> None:
    drill = promise("R4", wanted="every queued job sent again within 30 s")
    service = scaled.service
    running = two_at_work(service, samples.woman_full)  # longer than the rest takes
    waiting = [service.upload("/references", file) for file in (samples.dark_portrait, samples.pale_portrait)]
    before = 0

    def wiped() -> int:
        nonlocal before
        before = sent_again(service)  # first: the messages may be sent again before this is asked afterwards
        return scaled.broker.wipe(len(waiting))

    held = until(wiped)
    began = time.monotonic()
    until(lambda: sent_again(service) - before >= len(waiting), 120)
    taken = time.monotonic() - began
    attempts = {service.job(job)["attempt"] for job in running}
    for job in running:  # a fast machine has ended them
        assert service.client.post(f"/jobs/{job}/cancel").status_code in (202, 409)
    done = [service.finished(medium["job"]) for medium in waiting]
    drill.measured = f"{held} of {held} sent again after {taken:.1f} s, all succeeded ({AT})"
    drill.keep_to(taken, 30)
    assert attempts == {1}
    assert {(job["state"], job["attempt"]) for job in done} == {("succeeded", 1)}
