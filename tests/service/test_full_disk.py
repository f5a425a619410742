"""A disk that is really full: a small file system of its own."""

from __future__ import annotations

import errno
import os
import re
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from service.catalog import JobKind, Role, keys
from service.catalog.keys import Limits
from service.settings import Settings
from tests.promises import Drill
from tests.service.fixtures import PNG, Api, add_media, claim, job_of, make_ready, serve
from tests.waiting import until
from tests.worker.runners import runner_of
from worker import runner

MIB = 1024**2


@pytest.fixture(scope="module")
def small_disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """24 MiB; mounting needs root."""
    folder = tmp_path_factory.mktemp("disk")
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=24m,mode=0700", "tmpfs", str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    if mounted.returncode:
        assert re.search("superuser|permission denied", mounted.stderr), mounted.stderr
        pytest.skip("a file system can only be mounted as root")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def api(small_disk: Path) -> Iterator[Api]:
    yield from serve(Settings(data_dir=small_disk / "data", reap_interval_s=3600, min_free_bytes=4 * MIB))
    (small_disk / "others").unlink(missing_ok=True)
    shutil.rmtree(small_disk / "data")  # the next test's worker takes the job that waits for the longest


def fill(disk: Path) -> Path:
    """Write until there is no byte left, as another program may."""
    size = MIB
    with (path := disk / "others").open("ab", buffering=0) as file:
        while size:
            try:
                file.write(b"\1" * size)
            except OSError:
                size //= 2
    return path


def upload(api: Api, size: int) -> httpx.Response:
    return api.client.post("/references", content=PNG + os.urandom(size), headers={"content-type": "image/png"})


def test_a_full_disk_refuses_uploads_and_jobs_deletes_and_recovers_alone(
    api: Api, small_disk: Path, promise: Callable[..., Drill]
) -> None:
    drill = promise("R9", wanted="507, nothing partial, GET and DELETE work, recovers alone")
    known = [upload(api, 300_000).json()["id"] for _ in range(3)]
    video = add_media(api.services.database)
    make_ready(api.services, video.id)
    make_ready(api.services, known[0])
    wanted = {"video": video.id, "looks": [{"reference": known[0]}]}
    waiting = api.client.post("/transfer", json=wanted).json()
    assert waiting["waiting_for"] is None
    api.services.reaper.round()
    others = fill(small_disk)
    # a thread of the service may give a page back meanwhile
    until(lambda: fill(small_disk) == others and os.statvfs(small_disk).f_bavail == 0)
    until(
        lambda: fill(small_disk) == others and api.services.room.free_bytes() == 0
    )  # what others write is seen at the next look

    for answer in (upload(api, 100_000), upload(api, 3_000_000), api.client.post("/transfer", json=wanted)):
        assert (answer.status_code, answer.json()["code"]) == (507, "insufficient-storage")
    assert api.drafts == []
    fill(small_disk)  # what was refused had a part of the reserve given back
    ready = api.client.get("/readyz")  # whoever is not ready is asked nothing, and could not delete
    assert (ready.status_code, ready.json()["status"], ready.json()["checks"]["storage"]) == (200, "degraded", "full")
    assert api.client.get(f"/jobs/{waiting['id']}").json()["waiting_for"] == "room"
    assert api.client.delete(f"/references/{known[1]}?cancel_jobs=true").status_code == 204
    assert api.client.post(f"/jobs/{waiting['id']}/cancel").status_code == 202
    fill(small_disk)  # whoever filled it goes on
    assert api.client.delete(f"/references/{known[2]}?cancel_jobs=true").status_code == 204
    with api.services.background.write() as session:
        session.connection().exec_driver_sql("UPDATE media SET expires_at = '2000-01-01'")
    api.services.reaper.round()
    assert api.client.get("/references").json()["data"] == []
    until(lambda: api.blobs == [])

    others.unlink()
    api.services.reaper.round()
    assert (small_disk / "data" / "reserve").stat().st_size == 2 * MIB
    until(lambda: not api.services.room.is_short())
    assert upload(api, 100_000).status_code == 202
    until(lambda: api.client.get("/readyz").json()["checks"]["storage"] == "ok")
    drill.measured = "0 bytes free: 3 of 3 writes 507, ready, 2 of 2 deletes 204, expiry done; 202 once there was room"


def test_an_upload_that_runs_out_of_room_leaves_nothing(api: Api, small_disk: Path) -> None:
    before = api.blobs

    def pieces() -> Iterator[bytes]:  # of no declared length
        yield PNG
        while True:
            yield os.urandom(MIB)

    answer = api.client.post("/references", content=pieces(), headers={"content-type": "image/png"})
    assert answer.status_code == 507
    assert (api.drafts, api.blobs) == ([], before)
    assert os.statvfs(small_disk).f_bavail * 4096 > 4 * MIB


def test_a_worker_leaves_a_job_for_later_while_there_is_no_room(
    api: Api, small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "ROOM_WAIT_S", 0.05)
    medium = add_media(api.services.database, Role.REFERENCE)
    work = runner_of(api.services.settings)
    others = fill(small_disk)
    work.run(medium.job_id)
    until(api.services.room.is_short)
    body = api.client.get(f"/jobs/{medium.job_id}").json()
    assert (body["state"], body["attempt"], body["waiting_for"]) == ("queued", 1, "room")
    assert (body["progress"]["stage"], body["waiting_for"]) == (None, "room")
    others.unlink()
    work.run(medium.job_id)  # its file was never stored
    body = api.client.get(f"/jobs/{medium.job_id}").json()
    assert (body["state"], body["error"]["code"]) == ("failed", "source-lost")


def test_a_job_that_runs_out_of_room_is_tried_again_and_fails_at_last(
    api: Api, small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = api.services.database

    def fills_the_disk(run: runner.Run) -> bool:
        with (run.draft_folder() / "asset.pvg").open("wb") as file:
            while True:
                file.write(b"\1" * MIB)

    monkeypatch.setattr(runner, "_WORK", {JobKind.VECTORIZE: fills_the_disk})
    medium = add_media(database, Role.REFERENCE)
    work = runner_of(api.services.settings)
    seen = []
    for _ in range(4):
        work.run(medium.job_id)
        job = job_of(database, medium.job_id)
        seen.append((str(job.state), job.attempt, job.error and job.error["type"]))
    assert seen == [("queued", 2, None), ("queued", 3, None), *[("failed", 3, "insufficient-storage")] * 2]
    assert api.drafts == []
    claim(database, add_media(database).job_id)


@pytest.mark.parametrize(("attempts", "end"), [(2, ("queued", 2, None)), (1, ("failed", 1, "insufficient-storage"))])
def test_what_becomes_of_a_job_is_written_once_there_is_room_for_that(
    api: Api, small_disk: Path, monkeypatch: pytest.MonkeyPatch, attempts: int, end: tuple[str, int, str | None]
) -> None:
    def finds_a_full_disk(run: runner.Run) -> bool:
        others = fill(small_disk)
        until(lambda: fill(small_disk) == others and os.statvfs(small_disk).f_bavail == 0)
        threading.Timer(1.5, others.unlink).start()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(runner, "_WORK", {JobKind.VECTORIZE: finds_a_full_disk})
    medium = add_media(api.services.database, Role.REFERENCE)
    runner_of(api.services.settings.model_copy(update={"max_attempts": attempts})).run(medium.job_id)
    job = job_of(api.services.database, medium.job_id)
    assert (str(job.state), job.attempt, job.error and job.error["type"]) == end


def test_the_reserve_is_for_deletions_alone(api: Api, small_disk: Path) -> None:
    reserve = small_disk / "data" / "reserve"
    database = api.services.database
    with database.write() as session:
        _, secret = keys.create(session, "studio", Limits(), now=database.now())
    api.client.headers["Authorization"] = f"Bearer {secret}"
    made = [upload(api, 200_000).json()["id"] for _ in range(4)]
    assert api.client.get("/webhooks/secret").status_code == 200
    api.services.reaper.round()
    whole = reserve.stat().st_size
    others = fill(small_disk)
    until(lambda: fill(small_disk) == others and api.services.room.free_bytes() == 0)

    for _ in range(10):
        fill(small_disk)
        for post in ("/uploads/link", "/webhooks/secret/rotate"):
            json = {"role": "reference"} if post == "/uploads/link" else None
            assert api.client.post(post, json=json, headers={"Idempotency-Key": post}).status_code == 507
        assert api.client.get("/webhooks/secret").status_code == 200
        api.services.rates._held.clear()  # another minute
        assert api.client.get(f"/references/{made[0]}").status_code == 200
        api.services.reaper.round()
    assert reserve.stat().st_size == whole
    for medium in made:
        fill(small_disk)
        assert api.client.delete(f"/references/{medium}?cancel_jobs=true").status_code == 204
    assert reserve.stat().st_size < whole
