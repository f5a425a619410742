"""Deleting deletes: nothing of a face is left, and what cannot be deleted now is not forgotten."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from obstore.exceptions import GenericError
from sqlalchemy import select
from sqlalchemy.orm import Session

from service.api.commands import removal
from service.blobs import Blobs
from service.catalog import Asset, Database, Report, Role, jobs, leases, media, parts, results, sweep, tombstones
from service.catalog.models import Look, Result, Tombstone
from service.catalog.parts import NewFile, NewPart
from service.drafts import Drafts
from service.queue import RENDER, make_producer
from service.settings import Settings
from service.storage import Storage
from tests.folders import files_below
from tests.gallery.assets import write_asset
from tests.service.fixtures import (
    PNG,
    Api,
    FakeClock,
    add_media,
    add_transfer,
    claim,
    held_up,
    make_ready,
    make_results,
    serve,
)
from tests.service.object_store import BUCKET, ObjectStore, object_store
from tests.service.queue.test_broker import messages
from tests.service.s3 import S3
from tests.service.servers import fresh_database
from tests.side_by_side import at_once
from tests.threads import own_threads
from tests.waiting import until
from worker.runner import Runner
from worker.sandbox import MethodError, Sandbox

MARK = "a-name-that-nobody-else-has"


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Iterator[ObjectStore]:
    with object_store() as running:
        for name, value in running.environment().items():
            monkeypatch.setenv(name, value)
        yield running


@pytest.fixture(params=["folder", "s3"])
def api(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    for name in ("_REWRITE_S", "_REWRITE_SHARE"):  # what a round does every hour is done in each
        monkeypatch.setattr(f"service.catalog.database.{name}", 0)
    url = ""
    if request.param == "s3":
        url = request.getfixturevalue("bucket").storage_url
    if request.param == "hanging store":
        request.getfixturevalue("store")
        url = f"s3://{BUCKET}"
    yield from serve(Settings(data_dir=tmp_path / "data", reap_interval_s=3600, storage_url=url))


def buried(api: Api) -> int:
    with api.services.database.read() as session:
        return session.query(Tombstone).count()


def upload(api: Api, content: bytes, name: str = "me.png", metadata: str = "of:me") -> httpx.Response:
    return api.client.post("/videos", files={"file": (name, content)}, data={"metadata": metadata})


def found(api: Api, bucket: S3 | None, needles: list[bytes]) -> set[bytes]:
    """Those that are anywhere below the data folder or in the object store."""
    kept = bucket.contents() if bucket else []
    for path in files_below(api.services.settings.folder):
        with suppress(FileNotFoundError):  # drafts and messages come and go meanwhile
            kept.append(path.read_bytes())
    return {needle for needle in needles if any(needle in content for content in kept)}


def test_no_byte_of_a_deleted_clip_is_left(api: Api, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Neither of its source, nor of its landmarks, nor in a page of SQLite."""
    bucket = request.getfixturevalue("bucket") if "s3" in request.node.name else None
    source = PNG + os.urandom(200_000)
    video = upload(api, source, f"{MARK}.png", "of:number-4711-0815").json()
    (tmp_path / "source").write_bytes(source)
    asset = write_asset(tmp_path / "asset.pvg", tmp_path / "source")
    vectorized = asset.read_bytes()
    key = api.services.storage.key("asset", "0" * 64, video["id"], ".pvg")
    api.services.blobs.put(asset, key)
    database = api.services.database
    lease = claim(database, video["job"])
    faces = [{"index": 0, "width_px": 123.456789, "warnings": [MARK]}]
    with database.write() as session:
        media.finish(session, lease, Asset(key, 1, {}, faces, []), now=database.now(), timings={})
    # its reference alone is deleted first: the job's record stays, and the video
    wanted = {"video": upload(api, PNG + b"other").json()["id"], "looks": [{"reference": video["id"]}]}
    make_ready(api.services, wanted["video"])
    job = api.client.post("/transfer", json=wanted).json()
    drawn = os.urandom(100_000)
    warned = Report("landmarks", "table", warnings=("reference, face 0: 98.7654321 px",))
    make_results(api.services, job["id"], [drawn], report=warned)
    assert api.client.post("/transfer", json=wanted, headers={"Idempotency-Key": "k"}).status_code == 200

    pieces = [
        content[start : start + 32]
        for content in (source, vectorized, drawn)
        for start in range(64, len(content), 4096)
    ]
    needles = [*pieces, MARK.encode(), b"number-4711-0815", b"123.456789", b"98.7654321"]
    assert found(api, bucket, needles) == set(needles)
    assert buried(api) == 0
    assert api.client.delete(f"/videos/{video['id']}").status_code == 204

    def left() -> object:
        """A store may take its time, and while another looks into SQLite its log stays: the next round sees to it."""
        api.services.reaper.round()
        return found(api, bucket, needles) or len(api.blobs) > 2 or buried(api)

    until(lambda: not left(), said=left)
    look = api.client.get(f"/jobs/{job['id']}").json()["looks"][0]
    assert (look["warnings"], look["settings"], look["result_gone"]) == ([], None, "deleted")
    assert api.client.get(f"/jobs/{video['job']}").json()["metadata"] == {}


@pytest.mark.parametrize("api", ["folder"], indirect=True)
def test_no_name_of_a_deleted_clip_is_left_in_which_no_face_was_found(
    api: Api, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Neither with the job that waited for it, whose record stays, nor in the log."""

    def call(_: Sandbox, name: str, arguments: dict[str, Any], **__: object) -> None:
        raise MethodError("NoFaceError", f"no face found in any of 8 frames of {Path(arguments['source']).name}")

    monkeypatch.setattr(Sandbox, "call", call)
    caplog.set_level(logging.INFO)
    settings = api.services.settings
    video = upload(api, PNG + os.urandom(1000), f"{MARK}.png").json()
    wanted = {"video": video["id"], "looks": [{"reference": video["id"]}]}
    waiting = api.client.post("/transfer", json=wanted).json()
    with socket.socket() as unused:
        Runner(settings, make_producer(settings), Sandbox(unused)).run(video["job"])
    for place in (f"videos/{video['id']}", f"jobs/{video['job']}", f"jobs/{waiting['id']}"):
        error = api.client.get(f"/{place}").json()["error"]
        assert error["detail"] == "no face found in any of 8 frames of the file"
    assert found(api, None, [MARK.encode()])
    assert api.client.delete(f"/videos/{video['id']}").status_code == 204

    def left() -> object:
        api.services.reaper.round()
        return found(api, None, [MARK.encode()])

    until(lambda: not left(), said=left)
    assert api.client.get(f"/jobs/{waiting['id']}").json()["error"]["detail"].endswith("frames of the file")
    said = [str(vars(record)) for record in caplog.records]
    assert any("frames of the file" in line for line in said)
    assert not [line for line in said if MARK in line]


@pytest.mark.parametrize("api", ["hanging store"], indirect=True)
def test_what_a_hanging_store_does_not_delete_is_deleted_later(
    api: Api, store: ObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.blobs.PATIENCE_S", 0.3)
    reference = upload(api, PNG + b"x").json()
    store.deletes.clear()
    assert api.client.delete(f"/videos/{reference['id']}?cancel_jobs=true").status_code == 204  # while it hangs
    assert api.client.get(f"/videos/{reference['id']}").status_code == 404
    assert (len(store.blobs), buried(api)) == (1, 1)
    store.deletes.set()
    until(lambda: not buried(api))
    assert (store.blobs, buried(api)) == ({}, 0)


@pytest.mark.parametrize("api", ["hanging store"], indirect=True)
def test_a_file_for_which_a_store_takes_long_is_kept_while_it_is_sent(
    api: Api, store: ObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    services, began, passed_s = api.services, api.services.database.now(), 0.0
    for database in (services.database, services.background):
        monkeypatch.setattr(database, "now", lambda: began + timedelta(seconds=passed_s))
    monkeypatch.setattr("service.blobs.time", SimpleNamespace(monotonic=lambda: passed_s))

    def is_held() -> bool:
        with services.database.read() as session:
            return session.query(Tombstone).one().due_at > began + timedelta(seconds=passed_s + 600)

    begun = store.begun
    store.puts.clear()
    with ThreadPoolExecutor() as pool:
        sent = pool.submit(upload, api, PNG + b"x")
        until(lambda: store.begun > begun)
        for _ in range(4):
            passed_s += 600
            until(is_held, 10)
            assert services.reaper.delete() == 0
        store.puts.set()
    assert sent.result().status_code == 202
    assert (len(store.blobs), buried(api)) == (1, 0)


@pytest.mark.parametrize("api", ["folder"], indirect=True)
def test_failed_deletions_are_tried_again_ever_later(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    services, tries = api.services, []

    def fails(key: str) -> None:
        tries.append(key)
        raise OSError("the disk does not answer")

    clock = services.database.now()
    monkeypatch.setattr(services.database, "now", lambda: clock)
    reference = upload(api, PNG + b"x").json()
    with monkeypatch.context() as broken:
        broken.setattr(services.storage, "delete", fails)
        api.client.delete(f"/videos/{reference['id']}?cancel_jobs=true")
        assert [services.blobs.sweep() for _ in range(3)] == [0, 0, 0]
        assert len(tries) == 1  # not due before some seconds
        clock += timedelta(days=365)
        assert services.blobs.sweep() == 0
        assert len(tries) == 2
    clock += timedelta(days=365)
    assert services.blobs.sweep() == 1
    assert (api.blobs, buried(api)) == ([], 0)


@pytest.mark.parametrize("api", ["folder"], indirect=True)
@pytest.mark.parametrize("how", ["away", "slow", "hangs"])
def test_a_store_that_is_away_or_slow_keeps_no_round_of_the_reaper(
    api: Api, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    services, tries, answers, steady_s = api.services, list[str](), threading.Event(), 0.0

    def delete(key: str) -> None:
        nonlocal steady_s
        tries.append(key)
        if how == "away":
            raise GenericError("nobody answers")
        if how == "hangs":
            answers.wait(60)
        steady_s += 25

    monkeypatch.setattr("service.blobs.PATIENCE_S", 0.5 if how == "hangs" else 60)
    monkeypatch.setattr("service.blobs.time", SimpleNamespace(monotonic=lambda: steady_s))
    monkeypatch.setattr(services.storage, "delete", delete)
    with services.background.write() as session:
        tombstones.bury(session, [f"result/{number}" for number in range(100)], now=services.database.now())
    sweeping = own_threads("sweep-blobs")
    deleted = services.reaper.delete()
    until(lambda: tries)
    assert len(tries) == (3 if how == "slow" else 1)
    assert deleted == (3 if how == "slow" else 0)
    assert buried(api) == 100 - deleted
    if how == "hangs":
        assert services.reaper.delete() == 0  # nor does another thread hang on it
        assert len(tries) == 1
    with services.database.read() as session:  # what it did not come to is put off little, or not at all
        assert session.query(Tombstone).filter(Tombstone.attempts == 0).count() >= 90
    answers.set()
    until(lambda: not sweeping())


@pytest.mark.parametrize("api", ["folder"], indirect=True)
def test_deletions_from_a_store_that_hangs_keep_a_few_threads(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each left one more thread, for ever on a folder whose server is gone."""
    services, answers = api.services, threading.Event()
    blobs = Blobs(services.background, services.storage)
    monkeypatch.setattr("service.blobs.PATIENCE_S", 0.0)
    keys, deleting = [f"result/{number}" for number in range(40)], own_threads("delete-blobs")
    with monkeypatch.context() as patch:
        patch.setattr(services.storage, "delete", lambda _: answers.wait(60))
        for key in keys:
            blobs.discard([key])
        begun = len(deleting())
        answers.set()
        until(lambda: not deleting())
    assert begun == 16
    assert buried(api) == 24
    blobs.discard(keys)
    until(lambda: not buried(api))


@pytest.mark.parametrize("api", ["folder"], indirect=True)
def test_a_blob_whose_writer_is_killed_before_it_is_recorded_goes(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    services = api.services
    draft = services.storage.spool.draft()
    draft.write_bytes(b"a face")
    services.blobs.put(draft, "asset/x")
    services.reaper.round()
    assert api.blobs == ["asset/x"]  # it may be recorded yet
    medium, now = add_media(services.database, Role.REFERENCE), services.database.now()
    for database in (services.database, services.background):
        monkeypatch.setattr(database, "now", lambda: now + timedelta(days=365))
    lease = claim(services.database, medium.job_id)
    services.reaper.delete()
    assert api.blobs == []
    with pytest.raises(tombstones.LateError), services.background.write() as session:  # its writer only slept
        media.finish(session, lease, Asset("asset/x", 1, {}, [], []), now=services.database.now(), timings={})


@pytest.mark.parametrize("api", ["folder"], indirect=True)
def test_of_two_who_bring_a_lost_file_back_the_one_that_fails_takes_nothing_away(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    services, content = api.services, PNG + b"x"
    upload(api, content)
    (lost,) = api.blobs
    services.storage.delete(lost)
    exists, put = services.storage.exists, services.storage.put
    others: list[httpx.Response] = []

    def looked_at_before_another_brings_it(key: str) -> bool:
        monkeypatch.setattr(services.storage, "exists", exists)
        others.append(upload(api, content))
        monkeypatch.setattr(services.storage, "put", fails)
        return False

    def fails(path: Path, key: str, **_: object) -> None:
        put(path, key)
        raise GenericError("the answer of the store is lost")

    monkeypatch.setattr(services.storage, "exists", looked_at_before_another_brings_it)
    assert upload(api, content).status_code == 503
    assert others[0].status_code == 200
    now = services.database.now()
    for database in (services.database, services.background):
        monkeypatch.setattr(database, "now", lambda: now + timedelta(days=365))
    services.reaper.delete()
    with services.database.read() as session:
        medium = media.get(session, others[0].json()["id"])
    assert medium is not None
    assert (api.blobs, buried(api)) == ([medium.source_key], 0)


@pytest.mark.parametrize("api", ["folder"], indirect=True)
def test_two_who_bring_a_lost_file_back_leave_one_file(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    services, content = api.services, PNG + b"x"
    upload(api, content)
    services.storage.delete(api.blobs[0])
    put, both = services.storage.put, threading.Barrier(2, timeout=60)

    def together(path: Path, key: str, **_: object) -> None:
        both.wait()
        put(path, key)

    monkeypatch.setattr(services.storage, "put", together)
    answers = at_once([partial(upload, api, content)] * 2)
    assert [answer.status_code for answer in answers] == [200, 200]
    with services.database.read() as session:
        medium = media.get(session, answers[0].json()["id"])
    assert medium is not None
    services.reaper.delete()
    assert (api.blobs, buried(api)) == ([medium.source_key], 0)


def test_half_an_upload_goes_when_its_writer_is_killed_and_not_before(tmp_path: Path) -> None:
    storage = Storage(Settings(data_dir=tmp_path))
    code = "import sys, time; from service.storage import *; from service.settings import Settings\n"
    code += (
        "path, file = Storage(Settings()).spool.new_draft(); file.write(b'half'); file.flush(); "
        "path.with_suffix('.publish')"
    )
    code += ".hardlink_to(path); print(flush=True); time.sleep(60)"
    environment = os.environ | {"PVG_DATA_DIR": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        later = datetime.fromtimestamp(time.time() + 100, UTC)
        assert storage.spool.clear_drafts(held=set, before=later) == 0
        writer.send_signal(signal.SIGKILL)
        writer.wait()
    assert storage.spool.clear_drafts(held=set, before=datetime.fromtimestamp(time.time() - 100, UTC)) == 0  # too young
    assert storage.spool.clear_drafts(held=set, before=later) == 2
    assert list((tmp_path / "spool").iterdir()) == []


def test_a_young_draft_stays_on_a_machine_whose_clock_is_behind_the_databases(
    settings: Settings, database: Database, clock: FakeClock
) -> None:
    storage = Storage(settings)
    path, file = storage.spool.new_draft()
    file.close()  # as a picture that is about to be stored
    clock.time += timedelta(days=1)
    assert Drafts(database, storage.spool, settings).clear() == 0
    assert path.exists()


def test_a_copy_of_a_remote_blob_carries_its_job(tmp_path: Path, bucket: S3) -> None:
    storage = Storage(Settings(data_dir=tmp_path, storage_url=bucket.storage_url))
    draft = storage.spool.draft()
    draft.write_bytes(b"a face")
    storage.put(draft, "asset/x")
    job_id = f"job_{1:032x}"
    with storage.local_path("asset/x", job_id=job_id) as copy:
        assert copy.name.startswith(job_id)
        assert storage.spool.clear_drafts(held=lambda _: (), before=datetime.fromtimestamp(0, UTC)) == 1


@pytest.mark.parametrize("how", ["deleted", "canceled"])
def test_no_byte_of_a_part_is_left_and_no_message(api: Api, how: str, request: pytest.FixtureRequest) -> None:
    """Of a job that is done in parts, one of which is drawn and one being drawn."""
    store = request.getfixturevalue("bucket") if "s3" in request.node.name else None
    video = upload(api, PNG + os.urandom(1000)).json()
    make_ready(api.services, video["id"])
    job = api.client.post("/transfer", json={"video": video["id"], "looks": [{"reference": video["id"]}]}).json()
    database, blobs, storage = api.services.background, api.services.blobs, api.services.storage
    lease = claim(database, job["id"])
    with database.write() as session:
        wanted = [NewPart(video["id"], start, start + 100) for start in (0, 100, 200)]
        made = parts.split(session, lease, wanted, now=database.now(), timings={})
    assert made is not None
    api.services.publisher.publish(made)
    drawn = os.urandom(100_000)
    draft = storage.spool.draft()
    draft.write_bytes(drawn)
    file = NewFile(0, storage.key("drawn", "0" * 64, made[0].job_id, ".part"), len(drawn))
    blobs.put(draft, file.key)
    done, running = claim(database, made[0].job_id), claim(database, made[1].job_id)
    with database.write() as session:
        assert parts.finish(session, done, [file], now=database.now(), timings={}) == []
    message = f"{made[2].job_id}.{RENDER}.msg"

    def is_sent() -> bool:
        return message in {path.name for path in messages(api.services.settings)}

    until(is_sent)
    assert found(api, store, [drawn[:64]])
    assert api.client.get(f"/jobs/{job['id']}").json()["progress"]["frames_done"] == 100
    assert [one["id"] for one in api.client.get("/jobs?kind=transfer").json()["data"]] == [job["id"]]
    assert api.client.get(f"/jobs/{made[0].job_id}").status_code == 404
    if how == "deleted":
        assert api.client.delete(f"/videos/{video['id']}").status_code == 409
        assert api.client.delete(f"/videos/{video['id']}?cancel_jobs=true").status_code == 204
    else:
        assert api.client.post(f"/jobs/{job['id']}/cancel").json()["state"] == "canceling"
        with database.write() as session:  # its worker stops
            assert leases.confirm_cancel(session, running, now=database.now())
        blobs.sweep()
    assert api.client.get(f"/jobs/{job['id']}").json()["state"] == "canceled"
    until(lambda: not found(api, store, [drawn[:64]]))  # nobody waits for a slow store
    until(lambda: not is_sent())
    with database.write() as session:
        assert leases.held_state(session, running) is None


def _canceled_transfer(database: Database) -> tuple[list[str], str]:
    made = [add_media(database), add_media(database, Role.REFERENCE)]
    job_id = add_transfer(database, *made)
    with database.write() as session:
        jobs.cancel(session, job_id, now=database.now())
    return [one.id for one in made], job_id


def test_a_job_is_not_deleted_while_another_request_may_be_answered_with_it(database: Database) -> None:
    """Without keys nothing kept the two apart on a server: the answer told of a job that was gone."""
    media_ids, job_id = _canceled_transfer(database)
    services: Any = SimpleNamespace(database=database)
    with ThreadPoolExecutor(1) as other:
        with database.write() as session:  # as who asks for the same
            media.several(session, "", media_ids, lock=True)
            deleted = other.submit(removal._remove_job, services, "", job_id, None)
            until(lambda: held_up(database) or deleted.done())
            assert jobs.get(session, job_id, lock=True) is not None
        assert deleted.result() == []


def test_the_reaper_does_not_wait_for_a_job_that_is_being_deleted(
    postgres_url: str, postgres_tables: str, clock: FakeClock
) -> None:
    """Each had what the other wanted: results the one, the job the other."""
    with fresh_database(postgres_url, postgres_tables) as url, ThreadPoolExecutor(1) as reaper:
        database = Database(url, clock=clock, lock_wait_s=5)

        def expire() -> int:
            with database.write() as session:
                return sweep.expire_jobs(session, before=clock() + timedelta(days=1))

        _, job_id = _canceled_transfer(database)
        with database.write() as session:
            assert jobs.get(session, job_id, lock=True) is not None
            assert reaper.submit(expire).result() == 0
        assert expire() == 1
        database.close()


def test_a_medium_is_deleted_while_the_worker_that_vectorises_it_ends(database: Database) -> None:
    """The worker had the job and wanted the medium, the deletion the other way round."""
    made = add_media(database)
    lease = claim(database, made.job_id)
    services: Any = SimpleNamespace(database=database, publisher=SimpleNamespace(withdraw=lambda messages: None))
    with ThreadPoolExecutor(1) as other:
        with database.write() as session:  # as the worker
            assert leases.succeed(session, lease, now=database.now(), timings={})
            deleted = other.submit(removal._remove, services, "", Role.VIDEO, made.id, cancel_jobs=True, if_match=None)
            until(lambda: held_up(database) or deleted.done())
            assert media.get(session, made.id, lock="update") is not None
        assert deleted.result() == [made.source_key]


def test_a_medium_past_its_retention_goes_while_the_same_is_sent_again(database: Database) -> None:
    """The request had the job and wanted the medium, the reaper the other way round."""
    made = add_media(database)
    lease = claim(database, made.job_id)
    with database.write() as session:
        assert leases.fail(session, lease, {}, now=database.now(), timings={})
    late = database.now() + timedelta(days=400)

    def expire() -> list[str]:
        with database.write() as session:
            return sweep.expire_medium(session, made.id, now=late)

    with ThreadPoolExecutor(1) as other:
        with database.write() as session:  # as who finds the medium there
            assert jobs.get(session, made.job_id, lock=True) is not None
            expired = other.submit(expire)
            until(lambda: held_up(database) or expired.done())
            assert media.get(session, made.id, lock="update") is not None
        assert expired.result() == [made.source_key]


def _add_result(database: Database, job_id: str, blob_key: str | None) -> str:
    """A result of a job's only look, as if it had been drawn; its id."""
    with database.write() as session:
        (look,) = jobs.looks(session, job_id)
        look.result_id = f"res_{job_id}"
        session.add(
            Result(
                **{"id": look.result_id, "job_id": job_id, "position": 0, "blob_key": blob_key},
                **{"video_id": look.video_id, "reference_id": look.reference_id, "sha256": "0" * 64, "size_bytes": 1},
                **{"content_type": "video/mp4", "filename": "a.mp4", "created_at": database.now()},
                expires_at=database.now(),
            )
        )
        return look.result_id


def _delete_medium(session: Session, job_id: str) -> list[str]:
    found = media.get(session, jobs.looks(session, job_id)[0].video_id)
    assert found is not None
    return media.delete(session, found, now=datetime.now(UTC))


def _delete_result(session: Session, job_id: str) -> list[str]:
    return results.delete(session, f"res_{job_id}", now=datetime.now(UTC))


def _expire_results(session: Session) -> object:
    return sweep.expire_results(session, now=datetime.now(UTC) + timedelta(days=1))


def _expire_jobs(session: Session) -> object:
    return sweep.expire_jobs(session, before=datetime.now(UTC) + timedelta(days=1))


@pytest.mark.parametrize(
    ("expire", "delete", "blob_key", "expired"),
    [
        (_expire_results, _delete_result, "result/a", []),
        (_expire_results, _delete_medium, "result/a", []),
        (_expire_jobs, _delete_medium, None, 1),
    ],
)
def test_what_expires_and_what_is_deleted_are_locked_in_one_order(
    database: Database,
    expire: Callable[[Session], object],
    delete: Callable[[Session, str], list[str]],
    blob_key: str | None,
    expired: object,
) -> None:
    """The reaper had the results and wanted their looks, a deletion the other way round: a server ended one of them."""
    _, job_id = _canceled_transfer(database)
    _add_result(database, job_id, blob_key)

    def sweeps() -> object:
        with database.write() as session:
            return expire(session)

    with ThreadPoolExecutor(1) as reaper:
        with database.write() as session:  # as a deletion that has come as far as to the look
            session.execute(select(Look).where(Look.job_id == job_id).with_for_update())
            swept = reaper.submit(sweeps)
            until(lambda: held_up(database) or swept.done())
            delete(session, job_id)
        assert swept.result() == expired
