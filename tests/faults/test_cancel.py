"""Jobs that are canceled, while they wait and at the very moment of their end, on both settings: R13."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import pytest

from scripts.samples import Samples
from tests.faults.renders import small_picture, transfer, until_it_draws
from tests.promises import Drill
from tests.service.receivers import Receiver
from tests.waiting import until
from tests.worker.serving import Service, sandboxed, service_on

pytestmark = pytest.mark.slow

RACES, CLIENTS = 200, 2


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """With two slots for jobs, of one worker or of two."""
    settings = {"worker_concurrency": "2"} if request.param == "embedded" else {}
    yield from service_on(request, tmp_path_factory, allow_private_networks="true", **settings)


@pytest.fixture(scope="module")
def picture(service: Service, samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The id of a small picture that is ready: what is made of it takes no second."""
    path = small_picture(samples.portrait, tmp_path_factory.mktemp("small"), 320)
    return str(service.ready("/videos", path)["id"])


def test_a_queued_job_is_canceled_at_once_and_never_begun(
    service: Service, picture: str, samples: Samples, promise: Callable[..., Drill]
) -> None:
    """Those whose message is with the broker, and those that wait for their medium."""
    drill = promise("R13", wanted="queued: canceled within 0.5 s, and never begun")
    long = [service.upload("/videos", samples.woman_full, matching=matching) for matching in ("table", "chain")]
    for medium in long:  # both slots are taken
        service.at_work(medium["job"])
    queued = [transfer(service.client, picture, seed, force=True) for seed in range(15)]
    queued += [transfer(service.client, long[0]["id"], seed, force=True) for seed in range(5)]
    assert {service.job(job)["state"] for job in queued} == {"queued"}
    taken = []
    for job in queued:
        began = time.monotonic()
        assert service.client.post(f"/jobs/{job}/cancel").status_code == 202
        while service.job(job)["state"] != "canceled":
            assert time.monotonic() < began + 60
        taken.append(time.monotonic() - began)
    for medium in long:
        assert service.client.post(f"/jobs/{medium['job']}/cancel").status_code == 202
    after = service.finished(transfer(service.client, picture, 99, force=True))  # behind all of them
    begun = [job for job in queued if service.events("job begins", job=job)]
    drill.measured = f"{len(queued)} jobs: each within {max(taken):.2f} s, {len(begun)} begun"
    drill.keep_to(max(taken), 0.5)
    assert after["state"] == "succeeded"
    assert begun == []
    assert {service.job(job)["state"] for job in queued} == {"canceled"}


def test_a_render_that_is_canceled_stops_within_two_seconds(
    service: Service, samples: Samples, promise: Callable[..., Drill]
) -> None:
    """The process that draws is gone by then, too."""
    drill = promise("R13", wanted="running stops within 2 s")
    clip = str(service.ready("/videos", samples.woman_clip)["id"])
    job = transfer(service.client, clip, 0, force=True)
    until_it_draws(service, job)
    assert sandboxed(service)
    began = time.monotonic()
    assert service.client.post(f"/jobs/{job}/cancel").status_code == 202
    until(lambda: service.job(job)["state"] == "canceled" and not sandboxed(service), said=lambda: service.job(job))
    taken = time.monotonic() - began
    drill.measured = f"a clip that is drawn: ended, and no process of it left, after {taken:.2f} s"
    drill.keep_to(taken, 2)
    assert service.job(job)["looks"][0]["result"] is None


@dataclass(frozen=True)
class Race:
    """status: what the cancel was answered. ended: the job as soon as it had an end."""

    status: int
    ended: dict[str, Any]


def race(service: Service, video: str, number: int, url: str) -> list[Race]:
    """Races of one client: each cancel is sent later when the one before it won, and sooner when it came too late."""
    done: list[Race] = []
    with service.new_client() as client:
        wait_s = 0.0
        for seed in range(RACES // CLIENTS):
            job_id = transfer(client, video, 1000 * number + seed, webhook={"url": url}, force=True)
            began = time.monotonic()
            while seed == 0 and not client.get(f"/jobs/{job_id}").json()["done"]:
                wait_s = time.monotonic() - began  # how long one takes
            time.sleep(max(0.0, began + wait_s - time.monotonic()))
            status = client.post(f"/jobs/{job_id}/cancel").status_code
            ended = service.finished(job_id)
            done.append(Race(status, ended))
            wait_s *= 1.05 if ended["state"] == "canceled" else 1 / 1.05
    return done


def test_a_cancel_that_races_with_the_end_has_one_end(
    service: Service, picture: str, promise: Callable[..., Drill]
) -> None:
    drill = promise("R13", wanted=f"racing with the end, {RACES} times: one end state")
    before = results(service)
    with Receiver().listening() as receiver, ThreadPoolExecutor(CLIENTS) as clients:
        found = clients.map(lambda number: race(service, picture, number, receiver.url), range(1, CLIENTS + 1))
        races = [one for several in found for one in several]
        receiver.wait_for(RACES, 120)
        time.sleep(2)  # for one that is told twice
    states = Counter(one.ended["state"] for one in races)
    drill.measured = f"{len(races)} races: {states['canceled']} canceled, {states['succeeded']} succeeded"
    assert len(races) == RACES
    # both ends came about often enough to have been close
    assert states.keys() == {"canceled", "succeeded"}
    assert min(states.values()) >= RACES // 5
    told = Counter((json.loads(one.body)["data"]["id"], json.loads(one.body)["type"]) for one in receiver.got)
    for one in races:
        job_id, state = one.ended["id"], one.ended["state"]
        # who asked was told what became of it
        assert (one.status, state) in {(202, "canceled"), (409, "succeeded")}
        # and it stayed so, for everybody
        assert service.job(job_id)["state"] == state
        lines = service.client.get(f"/jobs/{job_id}/events").text.splitlines()
        events = [json.loads(line.removeprefix("data: ")) for line in lines if line.startswith("data: ")]
        assert [event["state"] for event in events if event.get("done")] == [state]
        assert told.pop((job_id, f"job.{state}")) == 1
        (look,) = one.ended["looks"]
        if state == "canceled":
            assert look["result"] is None
        else:
            assert service.client.get(look["url"]).status_code == 200
    assert not told
    # nothing is kept of those that were canceled
    until(lambda: results(service) == before + states["succeeded"], said=lambda: results(service))
    until(lambda: not service.drafts())


def results(service: Service) -> int:
    """How many finished files are kept."""
    return sum("result/" in key for key in service.blobs())
