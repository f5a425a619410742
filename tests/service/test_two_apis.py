"""Two APIs that share PostgreSQL, Redis and S3 and no folder: what one began, the other goes on with.

Each call of the service's client goes to the API that did not get the one before. No worker runs: what one would do is
done on the records.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import httpx
import pytest

from service.api import Services, make_services
from service.settings import Settings
from tests.service.api.test_resumable_uploads import begin, content, offset_of, send
from tests.service.fixtures import MP4, PNG, make_ready, make_results
from tests.service.receivers import Receiver
from tests.service.s3 import S3
from tests.service.servers import fresh_database
from tests.side_by_side import at_once
from tests.waiting import until
from tests.worker.serving import Service, Turns, running_scaled

FILE = os.urandom(300_000)


@pytest.fixture(scope="module")
def bucket_of_both(s3: S3) -> Iterator[S3]:
    with s3.fresh_bucket() as bucket:
        yield bucket


@pytest.fixture(scope="module")
def service(
    bucket_of_both: S3, postgres_url: str, redis_url: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Service]:
    with (
        fresh_database(postgres_url) as url,
        running_scaled(
            tmp_path_factory.mktemp("two"),
            database_url=url,
            broker_url=redis_url.replace("/0", "/5"),
            s3=bucket_of_both,
            workers=0,
            previews=0,
            allow_private_networks="true",
        ) as running,
    ):
        yield running


@pytest.fixture
def records(
    service: Service, bucket_of_both: S3, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Services]:
    """Records and blobs of the service, as a worker has them."""
    for name, value in bucket_of_both.environment().items():
        monkeypatch.setenv(name, value)
    services = make_services(Settings(data_dir=tmp_path / "data", **service.settings))
    yield services
    services.close()


@pytest.fixture
def apis(service: Service) -> Iterator[tuple[httpx.Client, httpx.Client]]:
    """A client of each."""
    first, second = (
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60, transport=Turns([port])) for port in service.ports
    )
    with first, second:
        yield first, second


def queued(service: Service) -> str:
    """A job that nobody works on."""
    answer = service.client.post("/videos", content=PNG + os.urandom(100))
    assert answer.status_code == 202, answer.text
    return str(answer.json()["job"])


def test_calls_go_to_both_in_turn(service: Service) -> None:
    before = len(service.events("request", path="/limits"))
    for _ in range(4):
        assert service.client.get("/limits").is_success
    # a line is written when its answer is on its way already
    until(lambda: len(service.events("request", path="/limits")) - before == 4)
    ports = {service.client.get("/limits").request.url.port for _ in range(4)}
    assert ports == set(service.ports)


def test_a_file_is_in_the_store_and_in_no_folder_of_theirs(service: Service) -> None:
    medium = service.client.post("/videos", content=MP4 + FILE).json()
    assert any(medium["id"] in key for key in service.blobs())
    assert [path for path in service.files() if FILE[:100] in path.read_bytes()] == []
    assert service.drafts() == []
    for _ in service.ports:
        whole = service.client.get(f"/videos/{medium['id']}/file")
        assert whole.content == MP4 + FILE
        part = service.client.get(f"/videos/{medium['id']}/file", headers={"Range": "bytes=1000-1999"})
        assert (part.status_code, part.content) == (206, (MP4 + FILE)[1000:2000])
        known = service.client.get(f"/videos/{medium['id']}/file", headers={"If-None-Match": whole.headers["etag"]})
        assert known.status_code == 304


def test_the_same_bytes_sent_to_both_at_once_are_one_video(apis: tuple[httpx.Client, httpx.Client]) -> None:
    data = MP4 + os.urandom(50_000)
    before = _uploads(apis[0])
    answers = at_once([partial(api.post, "/videos", content=data) for api in apis * 4])
    assert {answer.status_code for answer in answers} <= {200, 202}
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert _uploads(apis[1]) == (before[0] + 1, before[1] + len(data))


def _uploads(api: httpx.Client) -> tuple[int, int]:
    """How many files, and bytes, have been counted this month."""
    month = api.get("/usage").json()["months"][0]
    return month["uploads"], month["upload_bytes"]


def test_one_idempotency_key_at_both_is_one_job(
    service: Service, apis: tuple[httpx.Client, httpx.Client], records: Services
) -> None:
    video = service.client.post("/videos", content=PNG + os.urandom(100)).json()
    make_ready(records, video["id"])
    wanted = {"video": video["id"], "looks": [{"reference": video["id"]}], "force": True}

    def ask(number: int) -> httpx.Response:
        return apis[number % 2].post("/transfer", json=wanted, headers={"Idempotency-Key": "one"})

    answers = at_once([partial(ask, number) for number in range(20)])
    assert {answer.status_code for answer in answers} <= {202, 409}
    assert len({answer.json()["id"] for answer in answers if answer.status_code == 202}) == 1
    for number in range(2):
        again = ask(number)
        assert (again.status_code, again.headers["idempotent-replayed"]) == (202, "true")
    other = service.client.post("/transfer", json=wanted | {"force": False}, headers={"Idempotency-Key": "one"})
    assert other.status_code == 422


def test_a_file_comes_in_pieces_to_both(service: Service) -> None:
    data = content()
    url = begin(service.client, len(data))
    ports = set()
    for start in range(0, len(data), 50_000):
        answer = send(service.client, url, start, data[start : start + 50_000])
        assert answer.status_code == 204, answer.text
        ports.add(answer.request.url.port)
        if start + 50_000 < len(data) and start % 100_000:
            assert offset_of(service.client, url) == start + 50_000
    assert ports == set(service.ports)
    medium = service.client.get(f"/videos/{answer.headers['pvg-media']}").json()
    assert medium["sha256"] == hashlib.sha256(data).hexdigest()
    service.client.delete(f"/videos/{medium['id']}?cancel_jobs=true")


def test_a_link_of_one_opens_at_the_other(service: Service, records: Services) -> None:
    video = service.client.post("/videos", content=PNG + os.urandom(100)).json()
    make_ready(records, video["id"])
    job = service.client.post("/transfer", json={"video": video["id"], "looks": [{"reference": video["id"]}]}).json()
    (result,) = make_results(records, job["id"], [FILE])
    made = service.client.post(f"/results/{result}/link")
    opened = service.client.get(made.json()["url"])
    assert opened.content == FILE
    assert made.request.url.port != opened.request.url.port
    changed = service.client.get(made.json()["url"][:-2] + "xx")
    assert changed.status_code == 403
    upload = service.client.post("/uploads/link", json={})
    put = service.client.put(upload.json()["url"], content=PNG + os.urandom(10))
    assert put.status_code == 200, put.text
    assert service.client.put(upload.json()["url"], content=PNG + os.urandom(10)).is_client_error


def test_who_waits_at_one_hears_of_what_is_done_at_the_other(
    service: Service, apis: tuple[httpx.Client, httpx.Client]
) -> None:
    first, second = apis
    job = queued(service)
    etag = first.get(f"/jobs/{job}").headers["etag"]
    hears = threading.Event()

    def wait() -> dict[str, object]:
        answer = first.get(f"/jobs/{job}?wait=50", headers={"If-None-Match": etag})
        return dict(answer.json())

    def listen() -> list[str]:
        lines: list[str] = []
        with first.stream("GET", f"/jobs/{job}/events") as stream:
            for line in stream.iter_lines():
                lines += [line] if line else []
                if line.startswith("data: "):
                    hears.set()
        return lines

    with ThreadPoolExecutor(2) as clients:
        answer, lines = clients.submit(wait), clients.submit(listen)
        assert hears.wait(60)
        time.sleep(1)  # the other has asked as well; should it not have, it is told of the end at once
        assert second.post(f"/jobs/{job}/cancel").status_code == 202
        began = time.monotonic()
        body, taken_s = answer.result(60), time.monotonic() - began
        told = lines.result(60)
    assert body["state"] == "canceled"
    assert taken_s < 40  # not when its wait was over
    states = [json.loads(line.removeprefix("data: "))["state"] for line in told if line.startswith("data: ")]
    assert (states[0], states[-1]) == ("queued", "canceled")
    # the stream is gone on with at the other: it knows that the end was told
    last = [line.removeprefix("id: ") for line in told if line.startswith("id: ")][-1]
    assert second.get(f"/jobs/{job}/events", headers={"Last-Event-ID": last}).status_code == 204


def test_a_webhook_that_both_could_send_is_sent_once(service: Service) -> None:
    with Receiver().listening() as receiver:
        jobs = []
        for number in range(6):
            asked = {"webhook": (None, receiver.url), "file": ("me.png", PNG + bytes([number]) * 50)}
            jobs.append(service.client.post("/videos", files=asked).raise_for_status().json()["job"])
        for job in jobs:
            assert service.client.post(f"/jobs/{job}/cancel").status_code == 202
        receiver.wait_for(len(jobs))
        until(lambda: {one["state"] for one in service.client.get("/webhooks").json()["data"]} == {"delivered"})
        secrets = {service.client.get("/webhooks/secret").json()["secret"] for _ in range(2)}
        (secret,) = secrets
        assert sorted(one.verified(secret)["data"]["id"] for one in receiver.got) == sorted(jobs)


def test_what_is_deleted_at_one_is_gone_at_the_other(service: Service) -> None:
    medium = service.client.post("/videos", content=MP4 + os.urandom(1000)).json()
    assert service.client.delete(f"/videos/{medium['id']}?cancel_jobs=true").status_code == 204
    for _ in service.ports:
        assert service.client.get(f"/videos/{medium['id']}").status_code == 404
        assert service.client.get(f"/videos/{medium['id']}/file").status_code == 404
    until(lambda: not any(medium["id"] in key for key in service.blobs()))


def test_when_one_api_is_killed_the_other_goes_on_with_all_of_it(
    service: Service, apis: tuple[httpx.Client, httpx.Client]
) -> None:
    """The last test of this file: nobody starts it again."""
    first, second = apis
    data = content()
    url = begin(first, len(data))
    assert send(first, url, 0, data[:100_000]).status_code == 204
    job = queued(service)
    service.process.send_signal(signal.SIGKILL)
    service.process.wait()
    assert offset_of(second, url) == 100_000
    assert send(second, url, 100_000, data[100_000:]).status_code == 204
    assert second.post(f"/jobs/{job}/cancel").status_code == 202
    with pytest.raises(httpx.TransportError):
        first.get("/livez")
