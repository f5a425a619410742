"""Brokers and workers that die, with two APIs and two workers of one slot each: R1, R3, R4, R6."""

from __future__ import annotations

import json
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
import redis

from scripts.samples import Samples
from service.queue.broker import QUEUES
from tests.faults.renders import transfer, until_it_draws
from tests.gallery.clips import cut_clip
from tests.promises import Drill
from tests.service.receivers import Receiver
from tests.service.s3 import S3
from tests.service.servers import free_port, redis_server
from tests.waiting import until
from tests.worker.serving import Service, pool_child, running_afresh, running_service

#: shorter times than a service has by default (lease 30 s, rounds of the reaper 10 s), so that the drills are short
QUICK = {
    **{"lease_s": "8", "heartbeat_s": "1", "reap_interval_s": "1", "republish_after_s": "1"},
    "allow_private_networks": "true",  # receivers of webhooks are on this machine
}
#: a machine at work stands still for some seconds now and then, and no job may be begun anew for that
LASTING = {"lease_s": "20"}
AT = "at a lease of 20 s and a round a second"


class Broker:
    """A Redis server that can be stopped, and started again at the same port without what it held."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port, self._stack = folder, free_port(), ExitStack()
        self.url = self.start()

    def start(self) -> str:
        return self._stack.enter_context(redis_server(self._folder, self._port))

    def stop(self) -> None:
        self._stack.close()

    def kill(self) -> None:
        """End it as a crash does."""
        with redis.Redis(port=self._port) as client:
            os.kill(int(client.info("server")["process_id"]), signal.SIGKILL)
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
    parts = {"postgres_url": postgres_url, "broker_url": broker.url, "s3": s3}
    with running_afresh(folder, **parts, previews=0, patient=False, **QUICK | LASTING) as service:
        yield Scaled(service, broker)
    broker.stop()


@pytest.fixture(scope="module")
def brief_clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """120 frames of a woman, 640x360: seconds of work, of which a drill needs the first."""
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("clips") / "brief.mp4", 0, 120)


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


def video_ids(service: Service) -> set[str]:
    return {video["id"] for video in service.client.get("/videos").json()["data"]}


def test_a_job_whose_process_is_killed_succeeds_on_its_second_attempt(
    service: Service, brief_clip: Path, receiver: Receiver, promise: Callable[..., Drill]
) -> None:
    drill = promise("R1", wanted="mid-vectorisation: attempt 2 succeeds within 60 s + the work; one webhook")
    before = video_ids(service)
    medium = service.upload("/videos", brief_clip, webhook=receiver.url)
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
    assert video_ids(service) - before == {medium["id"]}
    until(lambda: not service.drafts())
    assert service.client.delete(f"/videos/{medium['id']}").status_code == 204
    assert [json.loads(one.body)["data"]["id"] for one in receiver.got] == [job["id"]]


@pytest.mark.slow
def test_a_render_whose_process_is_killed_has_one_result_and_one_webhook(
    service: Service, samples: Samples, receiver: Receiver, promise: Callable[..., Drill]
) -> None:
    drill = promise("R1", wanted="mid-render: attempt 2 succeeds within 60 s + the work; one result, one webhook id")
    video = service.ready("/videos", samples.woman_clip)["id"]
    before = service.blobs()
    job_id = transfer(service.client, video, 0, force=True, webhook={"url": receiver.url})
    until_it_draws(service, job_id)
    os.kill(pool_child(service, job_id), signal.SIGKILL)
    began = time.monotonic()
    until(lambda: service.job(job_id)["attempt"] == 2, 240)
    again = time.monotonic() - began
    job = service.finished(job_id)
    receiver.wait_for(1)
    until(lambda: not service.drafts())
    time.sleep(3)  # rounds in which another one would be told, and what is left over deleted
    results = [key for key in service.blobs() if key not in before]
    ids = {one.id for one in receiver.got}
    drill.measured = (
        f"attempt {job['attempt']} began after {again:.1f} s and {job['state']} ({AT}); {len(results)} result, "
        f"{len(ids)} webhook id"
    )
    drill.keep_to(again, 60)
    assert (job["state"], job["attempt"]) == ("succeeded", 2)
    (look,) = job["looks"]
    assert service.client.get(look["url"]).status_code == 200
    assert len(results) == 1
    assert look["sha256"] in results[0]
    assert [json.loads(one.body)["data"]["id"] for one in receiver.got] == [job_id]
    assert service.client.delete(f"/videos/{video}").status_code == 204


def is_at_work(service: Service, job_id: str, attempt: int) -> bool:
    """Whether this attempt of a job has done a frame; one that is queued shows those of the attempt before."""
    job = service.job(job_id)
    assert not job["done"], job
    return (job["state"], job["attempt"]) == ("running", attempt) and job["progress"]["frames_done"] >= 1


@pytest.mark.slow
def test_a_job_that_takes_its_worker_along_each_time_fails_after_three_and_the_next_one_runs(
    service: Service, samples: Samples, promise: Callable[..., Drill]
) -> None:
    drill = promise("R6", wanted="failed `worker-crashed` after 3; the next job runs")
    medium = service.upload("/videos", samples.woman_full)
    job_id = medium["job"]
    for attempt in (1, 2, 3):
        until(partial(is_at_work, service, job_id, attempt), 240, said=lambda: service.job(job_id))
        os.kill(pool_child(service, job_id), signal.SIGKILL)
    job = service.finished(job_id)
    began = time.monotonic()
    reference = service.upload("/references", samples.portrait)
    following = service.finished(reference["job"])
    drill.measured = (
        f"killed on each of {job['attempt']} attempts: {job['state']}, {job['error']['code']}; the next one "
        f"{following['state']} after {time.monotonic() - began:.1f} s, attempt {following['attempt']}"
    )
    assert (job["state"], job["attempt"], job["error"]["code"]) == ("failed", 3, "worker-crashed")
    assert (following["state"], following["attempt"]) == ("succeeded", 1)
    # other drills upload the same portrait, and count on its being new
    for path in (f"/videos/{medium['id']}", f"/references/{reference['id']}"):
        assert service.client.delete(path).status_code == 204


def two_at_work(service: Service, clip: Path) -> list[str]:
    """Jobs that take the only slot of either worker: all of a video, twice (of a reference a few frames are enough)."""
    jobs: list[str] = [service.upload("/videos", clip, matching=matching)["job"] for matching in ("table", "chain")]
    for job in jobs:
        service.at_work(job)
    return jobs


def test_busy_workers_outlive_their_broker(
    scaled: Scaled, brief_clip: Path, samples: Samples, promise: Callable[..., Drill]
) -> None:
    """Their only slots are taken while Redis goes away, so that nothing but the acknowledgement can tell them."""
    drill = promise("R3", wanted="running job not aborted; POST during the outage 202; no job lost")
    service = scaled.service
    running = two_at_work(service, brief_clip)
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


@pytest.mark.slow
def test_a_broker_that_is_killed_and_away_for_a_minute_costs_no_job(
    scaled: Scaled, samples: Samples, promise: Callable[..., Drill]
) -> None:
    drill = promise("R3", wanted="killed, 60 s away: running renders not aborted; each POST 202; no job lost")
    service = scaled.service
    clip, picture = (service.ready("/videos", one)["id"] for one in (samples.woman_clip, samples.portrait))
    renders = [transfer(service.client, clip, seed, force=True) for seed in range(2)]
    for render in renders:
        until_it_draws(service, render)
    waiting = [
        transfer(service.client, picture, seed, force=True) for seed in range(3)
    ]  # whose messages go with the broker
    until(lambda: scaled.broker.messages() >= len(waiting))
    assert {service.job(render)["state"] for render in renders} == {"running"}
    scaled.broker.kill()
    gone = time.monotonic()
    later = []
    while time.monotonic() < gone + 60:
        later.append(transfer(service.client, picture, 100 + len(later), force=True))
        time.sleep(4)
    meanwhile = {service.job(render)["state"] for render in renders}
    scaled.broker.start()
    away = time.monotonic() - gone
    done = [service.finished(job) for job in (*renders, *waiting, *later)]
    begun = [len(service.events("job begins", job=render)) for render in renders]
    drill.measured = (
        f"away for {away:.0f} s: renders {' and '.join(sorted(meanwhile))} then, begun {max(begun)} time each; "
        f"{len(later)} POSTs 202; {Counter(job['state'] for job in done)['succeeded']} of {len(done)} jobs succeeded"
    )
    assert meanwhile <= {"running", "succeeded"}  # a busy machine takes longer than a minute
    assert begun == [1] * len(renders)
    assert {(job["state"], job["attempt"]) for job in done} == {("succeeded", 1)}


def sent_again(service: Service) -> int:
    return sum(int(line["count"]) for line in service.events("publishing again"))


def test_what_a_wiped_broker_forgot_is_sent_again(
    scaled: Scaled, samples: Samples, promise: Callable[..., Drill]
) -> None:
    wipe(scaled, samples, promise("R4", wanted="every queued job sent again within 30 s"), AT)


@pytest.mark.slow
def test_what_a_wiped_broker_forgot_is_sent_again_in_the_default_time(
    postgres_url: str, s3: S3, tmp_path: Path, samples: Samples, promise: Callable[..., Drill]
) -> None:
    drill, broker = promise("R4", wanted="every queued job sent again within 30 s"), Broker(tmp_path)
    parts = {"postgres_url": postgres_url, "broker_url": broker.url, "s3": s3}
    with running_afresh(tmp_path, **parts, previews=0, patient=False) as service:
        wipe(Scaled(service, broker), samples, drill, "times as they are by default")
    broker.stop()


def wipe(scaled: Scaled, samples: Samples, drill: Drill, at: str) -> None:
    """Wipe the broker while jobs wait in it, and measure how long it is until all of them are in it again."""
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
    drill.measured = f"{held} of {held} sent again after {taken:.1f} s, all succeeded ({at})"
    drill.keep_to(taken, 30)
    assert attempts == {1}
    assert {(job["state"], job["attempt"]) for job in done} == {("succeeded", 1)}
