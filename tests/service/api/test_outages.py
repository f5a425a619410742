"""A database or an object store that is away, or locked: who can be answered is, the others are told when to ask."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from pydantic import SecretStr
from sqlalchemy.exc import OperationalError

from service.api import calls
from service.api.calls import Calls
from service.api.commands.registering import Registered, _Arrival
from service.catalog import keys
from service.settings import Settings
from tests.service.api.test_media import upload
from tests.service.fixtures import MP4, USUAL_PATIENCE_S, Api, make_ready, make_results, serve
from tests.service.servers import Wire, fresh_database, wire_to
from tests.waiting import until


@pytest.fixture
def wired(settings: Settings, postgres_url: str) -> Iterator[tuple[Wire, Api]]:
    """An API whose PostgreSQL is at the end of a wire."""
    with fresh_database(postgres_url) as url, wire_to(url) as (wire, far):
        for api in serve(settings.model_copy(update={"database_url": far})):
            yield wire, api


def is_unavailable(answer: httpx.Response) -> bool:
    return (
        answer.status_code == 503 and answer.json()["code"] == "unavailable" and int(answer.headers["retry-after"]) > 0
    )


def test_while_the_database_is_away_all_are_told_to_come_back(wired: tuple[Wire, Api]) -> None:
    wire, api = wired
    video = upload(api, "/videos")
    wire.cut()
    assert is_unavailable(api.client.get(f"/jobs/{video['job']}"))
    assert is_unavailable(api.client.get("/videos"))
    assert is_unavailable(api.client.post("/videos", content=MP4 + b"2"))
    assert is_unavailable(api.client.post(f"/jobs/{video['job']}/cancel"))
    assert api.client.get("/readyz").json()["checks"]["database"] == "unavailable"
    wire.connect()
    assert api.client.get(f"/jobs/{video['job']}").json()["state"] == "queued"
    assert api.client.post("/videos", content=MP4 + b"2").status_code == 202


def test_figures_are_shown_without_the_records_to_whom_they_were_shown_before(wired: tuple[Wire, Api]) -> None:
    wire, api = wired
    wire.cut()
    assert api.client.get("/metrics").status_code == 401  # whether there are keys was never read
    wire.connect()
    assert "pvg_database_up 1.0" in api.client.get("/metrics").text
    wire.cut()
    assert "pvg_database_up 0.0" in api.client.get("/metrics").text
    wire.connect()
    with api.services.background.write() as session:
        keys.create(session, "studio", keys.Limits(), now=api.services.database.now())
    assert api.client.get("/metrics").status_code == 401
    wire.cut()
    answer = api.client.get("/metrics")
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
    wire.connect()


def test_the_token_of_figures_is_asked_for_without_the_records(settings: Settings, postgres_url: str) -> None:
    with fresh_database(postgres_url) as url, wire_to(url) as (wire, far):
        changed = {"database_url": far, "metrics_token": SecretStr("scrape-me")}
        for api in serve(settings.model_copy(update=changed)):
            wire.cut()
            assert api.client.get("/metrics").status_code == 401
            answer = api.client.get("/metrics", headers={"Authorization": "Bearer scrape-me"})
            assert (answer.status_code, "pvg_database_up 0.0" in answer.text) == (200, True)
            wire.connect()


def test_a_database_that_hangs_holds_nobody_for_long(wired: tuple[Wire, Api], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calls, "_PATIENCE_S", USUAL_PATIENCE_S)
    wire, api = wired
    video = upload(api, "/videos")
    wire.hang()
    began = time.monotonic()
    with ThreadPoolExecutor(60) as clients:
        answers = list(clients.map(lambda _: api.client.get(f"/jobs/{video['job']}"), range(60)))
    assert all(is_unavailable(answer) for answer in answers)
    print(f"60 clients of a database that hangs are answered after {time.monotonic() - began:.1f} s")
    assert time.monotonic() - began < 28  # of one that looks at them one after the other, after minutes
    wire.connect()
    assert api.client.get(f"/jobs/{video['job']}").status_code == 200


@pytest.mark.embedded
def test_sixty_writers_that_wait_for_a_lock_hold_up_no_reader(api: Api) -> None:
    """Not one reader waits until a writer gives up, however slow the machine is."""
    video = upload(api, "/videos")
    path = api.services.settings.folder / "catalog.sqlite3"
    other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    other.execute("BEGIN IMMEDIATE")

    def write(number: int) -> httpx.Response:
        return api.client.post("/videos", content=MP4 + b"%d" % number, timeout=120)

    with ThreadPoolExecutor(60) as clients:
        writers = [clients.submit(write, number) for number in range(60)]
        until(lambda: len(api.drafts) == 60)  # all of them have sent their files
        taken = []
        for _ in range(10):
            began = time.monotonic()
            assert api.client.get(f"/jobs/{video['job']}").status_code == 200
            taken.append(time.monotonic() - began)
        ended = sum(writer.done() for writer in writers)
        stored = len(api.blobs)
        other.rollback()
        statuses = {writer.result().status_code for writer in writers}
    print(f"slowest GET beside 60 blocked writers: {max(taken):.3f} s")
    other.close()
    assert (ended, stored) == (0, 1)
    assert statuses == {202}


@contextmanager
def uploads_that_hang(api: Api, monkeypatch: pytest.MonkeyPatch, count: int) -> Iterator[list[Future[httpx.Response]]]:
    """So many files for a store that hangs for the time of the block; 16 are being stored. All are taken in then."""
    put, goes_on, begun = api.services.storage.put, threading.Event(), threading.Semaphore(0)

    def hangs(path: Path, key: str, **_: object) -> None:
        begun.release()
        goes_on.wait()
        put(path, key)

    monkeypatch.setattr(api.services.storage, "put", hangs)
    with ThreadPoolExecutor(count) as clients:
        contents = [MP4 + b"%d" % number for number in range(count)]
        uploads = [clients.submit(api.client.post, "/videos", content=one, timeout=120) for one in contents]
        try:
            assert all(begun.acquire(timeout=60) for _ in range(16))  # as many as there are threads for it
            yield uploads
        finally:
            goes_on.set()
        assert {one.result().status_code for one in uploads} == {202}


def test_twenty_files_that_are_stored_slowly_hold_up_no_writer(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    video = upload(api, "/videos")
    with uploads_that_hang(api, monkeypatch, 20) as uploads:
        assert api.client.post(f"/jobs/{video['job']}/cancel").status_code == 202
        assert api.client.get(f"/jobs/{video['job']}").json()["state"] == "canceled"
        assert not any(one.done() for one in uploads)


def test_a_store_that_hangs_keeps_nobody_waiting_for_a_thread(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """Uploads waited for each other, 16 at a time, for as long as the store hangs; so did deletions."""
    video = upload(api, "/videos")
    with uploads_that_hang(api, monkeypatch, 16):
        with monkeypatch.context() as patch:
            has_place = Calls._has_place  # all but this has the time that it needs
            patch.setattr(Calls, "_has_place", lambda one, _: has_place(one, 2.0))
            refused = api.client.post("/videos", content=MP4 + b"16", timeout=30)
        assert is_unavailable(refused)
        assert refused.json()["detail"] == "too many files wait to be stored; try again"
        assert api.client.delete(f"/videos/{video['id']}?cancel_jobs=true", timeout=30).status_code == 204
        assert api.client.get(f"/videos/{video['id']}").status_code == 404
        assert len(api.blobs) == 1
        api.services.reaper.round()
        assert api.blobs == []
    assert len(api.blobs) == 16


@pytest.mark.embedded
def test_a_lock_that_is_never_given_back_is_503(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calls, "_PATIENCE_S", USUAL_PATIENCE_S)
    path = api.services.settings.folder / "catalog.sqlite3"
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    began = time.monotonic()
    assert is_unavailable(api.client.post("/videos", content=MP4))
    assert 5 < time.monotonic() - began < 28
    assert api.blobs == []
    other.rollback()
    other.close()


@pytest.mark.embedded
def test_a_file_that_another_request_has_brought_goes_at_once_though_others_write(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second copy of somebody's face stayed for a quarter of an hour, also after the video was deleted."""
    path = api.services.settings.folder / "catalog.sqlite3"
    other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    create = _Arrival._create
    tries: list[str] = []

    def loses_once(arrival: _Arrival, media_id: str, key: str) -> Registered | None:
        tries.append(key)
        if len(tries) > 1:
            return create(arrival, media_id, key)
        other.execute("BEGIN IMMEDIATE")
        threading.Timer(1, other.rollback).start()
        return None

    monkeypatch.setattr(_Arrival, "_create", loses_once)
    upload(api, "/videos")
    other.close()
    assert len(tries) == 2
    assert len(api.blobs) == 1


def test_while_the_object_store_is_away_records_are_still_read(api: Api, settings: Settings) -> None:
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    job = api.client.post("/transfer", json={"video": video["id"], "looks": [{"reference": video["id"]}]}).json()
    (result,) = make_results(api.services, job["id"], [b"result"])
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (
            ("AWS_ACCESS_KEY_ID", "x"),
            ("AWS_SECRET_ACCESS_KEY", "x"),
            ("AWS_ENDPOINT", "http://127.0.0.1:1"),
            ("AWS_ALLOW_HTTP", "true"),
        ):
            patch.setenv(name, value)
        for away in serve(settings.model_copy(update={"storage_url": "s3://bucket"})):
            assert is_unavailable(away.client.get(f"/results/{result}", timeout=30))
            assert is_unavailable(away.client.post("/videos", content=MP4 + b"2", timeout=30))
            assert away.client.get(f"/jobs/{job['id']}").json()["state"] == "succeeded"
            assert away.client.get("/videos").json()["data"][0]["id"] == video["id"]


def _locked() -> OperationalError:
    error = sqlite3.OperationalError("database is locked")
    error.sqlite_errorcode = sqlite3.SQLITE_BUSY
    return OperationalError("SELECT", None, error)


@pytest.mark.parametrize(("times", "read"), [(3, True), (10_000, False)])
def test_what_reads_tries_again_for_a_lock_that_is_let_go_of(
    monkeypatch: pytest.MonkeyPatch, times: int, *, read: bool
) -> None:
    monkeypatch.setattr(calls, "_READ_AGAIN_S", 4.5)
    monkeypatch.setattr(calls, "_PAUSES_S", (0.0, 0.0))
    tries: list[int] = []

    def look() -> str:
        tries.append(1)
        if len(tries) <= times:
            raise _locked()
        return "read"

    async def tried() -> str:  # each try takes a second of this clock
        monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: float(len(tries)))
        return await Calls().read(look)

    if read:
        assert asyncio.run(tried()) == "read"
        assert len(tries) == times + 1
    else:
        with pytest.raises(OperationalError):
            asyncio.run(tried())
        assert len(tries) == 5
