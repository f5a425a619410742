from __future__ import annotations

import json
import socket
import threading
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from service.api import streams, waiting
from service.api.routers import events
from service.catalog import Key, Progress, jobs, keys, leases, sweep
from service.catalog.jobs import Standing
from tests.service.api.test_authentication import holder
from tests.service.api.test_media import upload
from tests.service.fixtures import MP4, Api, claim
from tests.threads import own_threads
from tests.waiting import until


@dataclass(frozen=True)
class Event:
    id: str
    name: str
    job: dict[str, Any]


def parsed(lines: Iterator[str]) -> Iterator[Event | str]:
    """Events, and comments, as an EventSource reads them."""
    fields: dict[str, str] = {}
    for line in lines:
        if line.startswith(":"):
            yield line
        elif line:
            name, _, value = line.partition(": ")
            fields[name] = value
        elif "data" in fields:
            yield Event(fields["id"], fields["event"], json.loads(fields["data"]))
            fields = {}


@contextmanager
def listening(api: Api, job_id: str, last_id: str | None = None) -> Iterator[Iterator[Event | str]]:
    headers = {} if last_id is None else {"Last-Event-ID": last_id}
    with api.client.stream("GET", f"/jobs/{job_id}/events", headers=headers) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert answer.headers["cache-control"] == "no-store"
        yield parsed(answer.iter_lines())


def take(stream: Iterator[Event | str]) -> Event:
    """The next event, after any comments: on a slow machine it is silent for long enough for them."""
    return next(one for one in stream if isinstance(one, Event))


def report(api: Api, lease: Any, frames: int) -> None:
    with api.services.background.write() as session:
        now = api.services.database.now()
        assert leases.report(session, lease, Progress("render", frames / 10, frames, 10), now=now)


def end(api: Api, lease: Any) -> None:
    with api.services.background.write() as session:
        assert leases.succeed(session, lease, now=api.services.database.now(), timings={})


def test_a_stream_tells_states_and_progress_and_ends_with_the_job(api: Api) -> None:
    job_id = upload(api, "/videos")["job"]
    with listening(api, job_id) as stream:
        first = take(stream)
        assert (first.name, first.job) == ("state", api.client.get(f"/jobs/{job_id}").json())
        lease = claim(api.services.database, job_id)
        running = take(stream)
        report(api, lease, 3)
        halfway = take(stream)
        end(api, lease)
        (last,) = [one for one in stream if isinstance(one, Event)]
    assert [(one.name, one.job["state"]) for one in (running, halfway, last)] == [
        ("state", "running"),
        ("progress", "running"),
        ("state", "succeeded"),
    ]
    assert halfway.job["progress"]["frames_done"] == 3
    assert last.job == api.client.get(f"/jobs/{job_id}").json()
    assert len({one.id for one in (first, running, halfway, last)}) == 4


def test_who_comes_again_is_told_what_is_new_and_the_end_once(api: Api) -> None:
    job_id = upload(api, "/videos")["job"]
    lease = claim(api.services.database, job_id)
    report(api, lease, 1)
    with listening(api, job_id) as stream:
        known = take(stream)
    with listening(api, job_id, known.id) as stream:  # nothing is new
        report(api, lease, 2)
        second = take(stream)
        assert second.job["progress"]["frames_done"] == 2
    report(api, lease, 5)
    with listening(api, job_id, second.id) as stream:  # told although it was not listening then
        assert take(stream).job["progress"]["frames_done"] == 5
    end(api, lease)
    with listening(api, job_id, second.id) as stream:
        (last,) = list(stream)
    assert isinstance(last, Event)
    assert last.job["state"] == "succeeded"
    again = api.client.get(f"/jobs/{job_id}/events", headers={"Last-Event-ID": last.id})
    assert (again.status_code, again.content) == (204, b"")
    for other in ("", "garbage", known.id):
        with listening(api, job_id, other) as stream:
            assert [one.job["state"] for one in stream if isinstance(one, Event)] == ["succeeded"]


def test_an_id_is_that_of_how_a_job_stands() -> None:
    one, other = Standing("running", 1, False, "render", 0.5, 1, 2), Standing("running", 1, False, "render", 0.6, 1, 2)
    assert events.event_id(one) == events.event_id(Standing("running", 1, False, "render", 0.5, 1, 2))
    assert events.event_id(one) != events.event_id(other)
    assert events.event_id(one) != events.event_id(one, 3)


def test_a_queued_job_tells_where_it_stands_and_when_others_make_way(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "PLACES_S", 0.3)
    monkeypatch.setattr(events, "HEARTBEAT_S", 0.5)
    first, second = (upload(api, "/videos", other)["job"] for other in (b"first", b"second"))
    with listening(api, second) as stream:
        now = take(stream)
        assert (now.name, now.job["queue"]) == ("state", {"position": 2})
        assert isinstance(next(stream), str)  # as long as nothing moves nothing is told
        assert api.client.post(f"/jobs/{first}/cancel").status_code == 202
        moved = take(stream)
    assert (moved.name, moved.job["queue"]) == ("progress", {"position": 1})
    assert moved.job == api.client.get(f"/jobs/{second}").json()
    with listening(api, second, moved.id) as stream:  # it was told
        assert isinstance(next(stream), str)


def test_a_silent_stream_has_heartbeats(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "HEARTBEAT_S", 0.1)
    with listening(api, upload(api, "/videos")["job"]) as stream:
        assert [isinstance(next(stream), str) for _ in range(4)] == [False, True, True, True]


def test_a_stream_ends_after_a_while_for_its_client_to_come_again(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    steady_s = 0.0
    loop = SimpleNamespace(time=lambda: steady_s)
    monkeypatch.setattr(events, "asyncio", SimpleNamespace(get_running_loop=lambda: loop))
    monkeypatch.setattr(events, "HEARTBEAT_S", 0.1)
    with listening(api, upload(api, "/videos")["job"]) as stream:
        assert [isinstance(next(stream), str) for _ in range(3)] == [False, True, True]
        steady_s = events.MAX_STREAM_S
        assert {type(one) for one in stream} <= {str}


def test_streams_end_when_the_service_stops(api: Api) -> None:
    with listening(api, upload(api, "/videos")["job"]) as stream:
        take(stream)
        api.services.watch.close()
        assert not [one for one in stream if isinstance(one, Event)]


def test_streams_hold_no_threads_and_leave_nothing_behind(api: Api) -> None:
    job_id = upload(api, "/videos")["job"]
    own = own_threads()
    clients = 100  # a pool for calls that are made keeps up to 40 threads for a while
    with httpx.Client(base_url=api.client.base_url, timeout=30, limits=httpx.Limits()) as client:
        requests = [client.build_request("GET", f"/jobs/{job_id}/events") for _ in range(clients)]
        answers = [client.send(one, stream=True) for one in requests]
        streams = [parsed(answer.iter_lines()) for answer in answers]
        assert {take(stream).job["state"] for stream in streams} == {"queued"}
        assert api.services.streams.open == clients
        added = len(own())
        print(f"{added} threads more for {clients} streams")
        assert added < clients / 2
        for answer in answers[1:]:
            answer.close()
        until(lambda: api.services.streams.open == 1)
        claim(api.services.database, job_id)
        assert take(streams[0]).job["state"] == "running"
        answers[0].close()
    until(lambda: api.services.streams.open == 0)


def test_a_key_has_so_many_streams_and_no_more(api: Api) -> None:
    greedy, other = holder(api), holder(api)
    job_id = greedy.post("/videos", content=MP4).json()["job"]
    theirs = other.post("/videos", content=MP4).json()["job"]
    headers = {"Authorization": f"Bearer {greedy.text}"}
    with httpx.Client(base_url=api.client.base_url, timeout=30, headers=headers, limits=httpx.Limits()) as client:
        request = client.build_request("GET", f"/jobs/{job_id}/events")
        answers = [client.send(request, stream=True) for _ in range(100)]
        assert {answer.status_code for answer in answers} == {200}
        refused = client.get(f"/jobs/{job_id}/events")
        assert (refused.status_code, refused.json()["code"]) == (429, "quota-exceeded")
        assert (refused.json()["limit"], refused.json()["unit"]) == (100, "streams")
        assert client.get(f"/jobs/{job_id}").status_code == 200
        with api.client.stream(
            "GET", f"/jobs/{theirs}/events", headers={"Authorization": f"Bearer {other.text}"}
        ) as stream:
            assert stream.status_code == 200
        assert other.get(f"/jobs/{job_id}/events").status_code == 404
        for answer in answers:
            answer.close()


@pytest.mark.parametrize("how", ["revoked", "rotated"])
def test_who_listens_or_waits_hears_no_more_once_the_key_has_ended(api: Api, how: str) -> None:
    one = holder(api)
    api.client.headers["Authorization"] = f"Bearer {one.text}"
    job_id = one.upload().json()["job"]
    with ThreadPoolExecutor(1) as threads, listening(api, job_id) as stream:
        assert take(stream).job["state"] == "queued"
        waiting_ = threads.submit(api.client.get, f"/jobs/{job_id}?wait=20")
        until(lambda: len(api.services.watch._waiting.get(job_id, ())) == 2)
        with api.services.background.write() as session:
            key = session.get_one(Key, one.id)
            keys.rotate(key) if how == "rotated" else keys.revoke(session, key, now=api.services.database.now())
            jobs.cancel(session, job_id, now=api.services.database.now())
        assert [one for one in stream if isinstance(one, Event)] == []
        assert waiting_.result().status_code == 401


def test_an_unknown_job_has_no_events(api: Api) -> None:
    assert api.client.get("/jobs/job_0/events").status_code == 404


def test_streams_that_are_opened_together_are_no_more_than_may_be(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "PER_OWNER", 3)
    job_id, clients = upload(api, "/videos")["job"], 40
    together = threading.Barrier(clients)
    request = f"GET /v1/jobs/{job_id}/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()

    def status(_: int) -> str:
        with socket.create_connection(api.address, timeout=120) as connection:
            together.wait(120)
            connection.sendall(request)
            line = connection.recv(12).decode()
            together.wait(120)  # those that were opened stay open until all are answered
            return line

    with ThreadPoolExecutor(clients) as threads:
        answers = Counter(threads.map(status, range(clients)))
    assert answers == {"HTTP/1.1 200": 3, "HTTP/1.1 429": clients - 3}
    until(lambda: api.services.streams.open == 0)


@pytest.mark.parametrize("how", ["events", "wait"])
def test_who_waits_for_a_job_that_ended_and_was_deleted_between_two_looks_waits_no_more(api: Api, how: str) -> None:
    """Its end was never seen: the stream went on with heartbeats for an hour, and the wait for all of its time."""
    job_id = upload(api, "/videos")["job"]
    path = f"/jobs/{job_id}/events" if how == "events" else f"/jobs/{job_id}?wait=60"
    heard: list[httpx.Response] = []
    client = threading.Thread(target=lambda: heard.append(api.client.get(path, timeout=90)))
    client.start()
    until(lambda: job_id in api.services.watch._waiting)
    with api.services.database.write() as session:  # no look comes in between
        jobs.cancel(session, job_id, now=api.services.database.now())
        sweep.delete_job(session, job_id, now=api.services.database.now())
    client.join(50)  # before the time of the wait is over
    assert [one.status_code for one in heard] == [200 if how == "events" else 404]
