from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Collection, Mapping
from itertools import pairwise
from typing import Any

import pytest

from service.api import waiting
from service.api.calls import Calls
from service.api.waiting import PLACES_S, POLL_S, JobWatch, PreviewWatch, Snapshot
from service.catalog import Preview
from service.catalog.jobs import Standing
from service.errors import UnavailableError
from tests.service.api.test_media import upload
from tests.service.fixtures import Api, make_ready

CLIENTS = 200


async def wait_for(api: Api, jobs: list[str], change: Callable[[], object]) -> list[tuple[dict[str, Any], float]]:
    """The answers of clients that wait for these jobs, each with when it came, in seconds after the change.

    It is made once all of them wait.
    """

    async def one(job_id: str) -> tuple[dict[str, Any], float]:
        reader, writer = await asyncio.open_connection(*api.address)
        writer.write(f"GET /jobs/{job_id}?wait=60 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        answer = await reader.read()
        at = time.monotonic()
        writer.close()
        body: dict[str, Any] = json.loads(answer.partition(b"\r\n\r\n")[2])
        return body, at

    waiting = [asyncio.create_task(one(job_id)) for job_id in jobs]
    watch = api.services.watch
    async with asyncio.timeout(50):  # before the first has waited for too long
        while sum(map(len, list(watch._waiting.values()))) < len(jobs):
            await asyncio.sleep(0.05)
    assert not any(task.done() for task in waiting)
    await asyncio.to_thread(change)
    changed = time.monotonic()
    return [(body, at - changed) for body, at in await asyncio.gather(*waiting)]


def test_two_hundred_clients_hear_of_an_end_by_one_look(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    video, other = upload(api, "/videos"), upload(api, "/videos", b"other")

    def change() -> None:
        make_ready(api.services, other["id"])
        make_ready(api.services, video["id"])

    watch, looks = api.services.watch, list[float]()
    load = watch._load

    def counted(job_ids: Collection[str]) -> Mapping[str, bytes]:
        looks.append(time.monotonic())
        return load(job_ids)

    monkeypatch.setattr(watch, "_load", counted)
    answers = asyncio.run(wait_for(api, [video["job"], other["job"]] * (CLIENTS // 2), change))
    assert {body["id"] for body, _ in answers[::2]} == {video["job"]}
    assert answers[0][0] == api.client.get(f"/jobs/{video['job']}").json()
    assert {body["state"] for body, _ in answers} == {"succeeded"}
    last = max(at for _, at in answers)
    print(f"the last of {CLIENTS} heard of it after {last:.2f} s")  # 0.5 s where nothing else runs
    assert all(later - one > 0.9 * POLL_S for one, later in pairwise(looks))  # however many wait
    assert last < 25  # before their time was over


def test_clients_that_wait_are_answered_when_the_service_stops(api: Api) -> None:
    video = upload(api, "/videos")
    answers = asyncio.run(wait_for(api, [video["job"]] * 20, api.services.watch.close))
    assert {body["state"] for body, _ in answers} == {"queued"}
    assert max(at for _, at in answers) < 25  # they would wait for a minute


def test_an_outage_is_two_lines_of_the_log_however_long_it_is(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    looks = 0

    def stand(job_ids: Collection[str]) -> dict[str, Standing]:
        nonlocal looks
        looks += 1
        if 2 <= looks <= 6:
            raise UnavailableError("away")
        return {
            job_id: Standing("succeeded" if looks > 8 else "running", 1, False, None, 0.0, 0, 0) for job_id in job_ids
        }

    def load(job_ids: Collection[str]) -> dict[str, Snapshot]:
        return {job_id: Snapshot(standing, b"{}") for job_id, standing in stand(job_ids).items()}

    async def wait() -> bytes | None:
        return await JobWatch(Calls(), stand, load).end_of("job_1", 60)

    assert asyncio.run(wait()) == b"{}"
    said = [record.getMessage() for record in caplog.records if record.name == "service.api.waiting"]
    assert [one.split(" be ")[0] for one in said] == [
        "jobs that are waited for cannot",
        "jobs that are waited for can",
    ]


def test_an_outage_is_two_lines_of_the_log_for_pictures_too(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    looks = 0

    def load(preview_ids: Collection[str]) -> tuple[list[Preview], Collection[str]]:
        nonlocal looks
        looks += 1
        if 2 <= looks <= 6:
            raise UnavailableError("away")
        return [Preview(id=one) for one in preview_ids if looks > 8], preview_ids

    made = asyncio.run(PreviewWatch(Calls(), load).end_of("prv_1", 60))
    assert made is not None
    said = [record.getMessage() for record in caplog.records if record.name == "service.api.waiting"]
    assert [one.split(" be ")[0] for one in said] == [
        "pictures that are waited for cannot",
        "pictures that are waited for can",
    ]


def test_places_are_looked_at_now_and_then_and_only_those_of_queued_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "POLL_S", PLACES_S / 100)
    loads: list[tuple[float, set[str]]] = []
    standings = {
        "job_1": Standing("queued", 1, False, None, 0.0, 0, 0),
        "job_2": Standing("queued", 1, True, None, 0.0, 0, 0),
        "job_3": Standing("running", 1, False, "render", 0.5, 1, 2),
    }

    def stand(job_ids: Collection[str]) -> dict[str, Standing]:
        return {job_id: standings[job_id] for job_id in job_ids}

    def load(job_ids: Collection[str]) -> dict[str, Snapshot]:
        loads.append((time.monotonic(), set(job_ids)))
        return {job_id: Snapshot(standings[job_id], b"{}", 9 - len(loads)) for job_id in job_ids}

    async def wait() -> list[Snapshot | None]:
        watch = JobWatch(Calls(), stand, load)
        others = [
            asyncio.create_task(watch.change_of(job_id, Snapshot(standings[job_id], b"{}"), 30))
            for job_id in ("job_2", "job_3")
        ]
        found = [await watch.change_of("job_1", Snapshot(standings["job_1"], b"{}", 8), 30)]
        watch.close()
        return found + await asyncio.gather(*others)

    moved, *others = asyncio.run(wait())
    assert moved is not None
    assert moved.position == 7
    assert others == [None, None]
    assert [asked for _, asked in loads] == [{"job_1"}, {"job_1"}]  # the first found it where it was
    # when a look begins in its thread is a matter of the machine; looks at how jobs stand are a hundred times as many
    assert loads[1][0] - loads[0][0] > 0.5 * PLACES_S
