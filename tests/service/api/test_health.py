from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import pytest

from service.api import calls, probes
from service.api.calls import Calls
from service.api.probes import OK, UNAVAILABLE, Probe
from service.catalog import workers
from service.catalog.collecting import Mark
from service.collector import HaltedError
from service.settings import Settings
from service.storage import Storage
from tests.service.fixtures import MP4, PNG, Api, serve
from tests.service.s3 import S3
from tests.waiting import until


@pytest.fixture
def brokerless(settings: Settings) -> Iterator[Api]:
    """An API whose broker is away."""
    yield from serve(settings.model_copy(update={"broker_url": "redis://127.0.0.1:1/0"}))


def test_a_running_service_is_live_and_ready(api: Api) -> None:
    beat(api)
    assert api.client.get("/livez").json() == {"status": "ok"}
    ready = api.client.get("/readyz")
    assert ready.status_code == 200
    checks = {"database": "ok", "storage": "ok", "broker": "ok", "workers": "ok", "collector": "ok"}
    assert ready.json() == {"status": "ok", "checks": checks}
    assert api.blobs == []


def test_a_service_with_little_room_is_ready_and_says_so_once(
    api: Api, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    beat(api)
    monkeypatch.setattr("service.room._free", lambda _: 1000)
    until(api.services.room.is_short)
    api.services.room._look()
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"], ready.json()["checks"]["storage"]) == (200, "degraded", "full")
    assert api.client.post("/references", content=PNG, headers={"content-type": "image/png"}).status_code == 507
    monkeypatch.undo()
    until(lambda: not api.services.room.is_short())
    assert api.client.get("/readyz").json()["checks"]["storage"] == "ok"
    said = [record for record in caplog.records if record.name == "service.room"]
    assert [record.message for record in said if record.levelname == "WARNING"] == [
        "too little room on the disk: uploads and new jobs are refused"
    ]


def beat(api: Api, lacks: str | None = None, *, late_s: float = 0) -> None:
    """What a worker says of itself."""
    now = api.services.database.now() - timedelta(seconds=late_s)
    with api.services.background.write() as session:
        workers.beat(session, "one", now=now, lacks=lacks)


def test_a_hundred_who_ask_at_once_share_one_check(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """It writes to the store, and whoever asks needs no key."""
    monkeypatch.setattr(probes, "KEEP_S", 60.0)
    ping, pings = Storage.ping, []

    def counted(storage: Storage) -> None:
        pings.append(storage)
        ping(storage)

    monkeypatch.setattr(Storage, "ping", counted)
    for api in serve(settings):
        with ThreadPoolExecutor(20) as clients:
            answers = list(clients.map(api.client.get, ["/readyz"] * 100))
        assert {answer.json()["checks"]["storage"] for answer in answers} == {"ok"}
        assert len(pings) == 1
        monkeypatch.setattr(probes, "KEEP_S", 0.0)
        assert api.client.get("/readyz").json()["checks"]["storage"] == "ok"
        assert len(pings) == 2


def test_a_part_that_hangs_keeps_one_thread_however_often_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Each /readyz left one more thread, until the container had no more."""
    monkeypatch.setattr(probes, "KEEP_S", 0.0)
    goes_on, begun = threading.Event(), []

    def hangs() -> None:
        begun.append(threading.get_ident())
        goes_on.wait(60)

    async def ask() -> None:
        probe = Probe("storage", Calls(), hangs)
        try:
            with monkeypatch.context() as patch:
                patch.setattr(calls, "_PATIENCE_S", 0.2)
                assert [await probe.state() for _ in range(5)] == [UNAVAILABLE] * 5
            assert len(begun) == 1
        finally:
            goes_on.set()
        while await probe.state() != OK:
            await asyncio.sleep(0.01)

    asyncio.run(ask())
    assert len(begun) == 2
    (line,) = [record for record in caplog.records if record.msg == "not ready"]
    assert vars(line)["reason"] == "no answer in time"


def test_a_service_without_workers_takes_jobs_and_says_so(api: Api) -> None:
    beat(api, late_s=16)  # it was killed: of three heartbeats none came
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"], ready.json()["checks"]["workers"]) == (200, "degraded", "none")


def test_a_service_whose_workers_can_do_nothing_is_not_ready(api: Api) -> None:
    beat(api, "network weights")
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (503, "unavailable")
    assert ready.json()["checks"]["workers"] == "no network weights"
    beat(api)
    assert api.client.get("/readyz").status_code == 200


@pytest.mark.parametrize("lacks", [workers.BROKER, workers.DISK])
def test_workers_without_their_broker_or_disk_are_told_and_work_is_taken(api: Api, lacks: str) -> None:
    beat(api, lacks)
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (200, "degraded")
    assert ready.json()["checks"]["workers"] == f"no {lacks}"


def test_a_service_whose_files_may_be_of_another_database_says_so(api: Api) -> None:
    beat(api)
    storage, collector = api.services.storage, api.services.collector
    collector.collect()
    assert Mark.read(storage.mark() or "").number > 0
    storage.set_mark("another 1\n")
    with pytest.raises(HaltedError):
        collector.collect()
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (200, "degraded")
    assert ready.json()["checks"]["collector"] == "halted: another-database"


def test_a_service_that_stops_is_not_ready_first(api: Api) -> None:
    api.services.watch.close()
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (503, "stopping")
    assert api.client.get("/livez").status_code == 200


def test_without_its_broker_the_service_takes_work(brokerless: Api) -> None:
    ready = brokerless.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (200, "degraded")
    assert ready.json()["checks"]["broker"] == "unavailable"
    video = brokerless.client.post("/videos", content=MP4)
    assert video.status_code == 202
    look = {"reference": video.json()["id"]}
    assert brokerless.client.post("/transfer", json={"video": video.json()["id"], "looks": [look]}).status_code == 202


@pytest.mark.embedded
def test_without_its_storage_the_service_is_not_ready(api: Api) -> None:
    folder = api.services.settings.local_storage_folder
    assert folder is not None
    folder.rename(folder.with_name("moved"))  # at once: the service's own probe writes there meanwhile
    folder.write_text("in the way")
    ready = api.client.get("/readyz")
    assert (ready.status_code, ready.json()["status"]) == (503, "unavailable")
    assert ready.json()["checks"]["storage"] == "unavailable"


def test_without_its_bucket_the_service_is_not_ready_until_it_is_there(
    s3: S3, bucket: S3, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probes, "KEEP_S", 0.0)
    name = f"{bucket.bucket}-later"
    for api in serve(settings.model_copy(update={"storage_url": f"s3://{name}"})):
        assert api.client.get("/readyz").json()["checks"]["storage"] == "unavailable"
        refused = api.client.post("/videos", content=MP4)
        assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
        assert api.drafts == []
        s3.client().create_bucket(Bucket=name)
        assert api.client.get("/readyz").json()["checks"]["storage"] == "ok"
        medium = api.client.post("/videos", content=MP4)
        assert medium.status_code == 202
        assert api.client.delete(f"/videos/{medium.json()['id']}?cancel_jobs=true").status_code == 204
        until(lambda api=api: api.blobs == [])
    s3.client().delete_bucket(Bucket=name)


def test_why_a_store_is_away_is_said_once(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A store at an http:// address was away for ever, and no line said why."""
    monkeypatch.setattr(probes, "KEEP_S", 0.0)
    caplog.set_level("INFO")
    for name, value in S3("http://127.0.0.1:1").environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("AWS_ALLOW_HTTP")
    for api in serve(settings.model_copy(update={"storage_url": "s3://faces"})):
        for _ in range(3):
            assert api.client.get("/readyz").json()["checks"]["storage"] == "unavailable"
        monkeypatch.setattr(api.services.probes[1], "_check", lambda: None)
        for _ in range(2):
            assert api.client.get("/readyz").json()["checks"]["storage"] == "ok"
    said = [record for record in caplog.records if record.name == "service.api.probes"]
    assert [record.msg for record in said] == ["not ready", "ready again"]
    assert "AWS_ALLOW_HTTP=true" in vars(said[0])["reason"]


def test_with_wrong_credentials_the_service_is_not_ready(
    bucket: S3, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probes, "KEEP_S", 0.0)
    for api in serve(settings.model_copy(update={"storage_url": bucket.storage_url})):
        with bucket.checking_signatures():
            ready = api.client.get("/readyz")
            assert (ready.status_code, ready.json()["checks"]["storage"]) == (503, "unavailable")
            assert api.client.post("/videos", content=MP4).status_code == 503
        assert api.client.get("/readyz").json()["checks"]["storage"] == "ok"
