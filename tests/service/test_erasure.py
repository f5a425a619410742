"""A customer who leaves: all that a key has is erased, beside a running service, and nothing of another one's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from sqlalchemy import select
from typer.testing import CliRunner

from service.blobs import Blobs
from service.catalog import LookParams, StillRequest, belongings, jobs, keys, ledger, parts, previews, webhooks
from service.catalog.models import Base, Key, Tombstone
from service.catalog.parts import NewFile, NewPart
from service.catalog.previews import Still
from service.cli import cli
from service.settings import Settings
from service.storage import Storage
from tests.folders import contents_below, files_below
from tests.parts import fresh_parts
from tests.service.api.test_authentication import holder
from tests.service.api.test_resumable_uploads import PIECE, TUS, said
from tests.service.fixtures import MP4, PNG, Api, claim, make_ready, make_results, serve
from tests.service.s3 import S3
from tests.waiting import until

#: of keys and of counts by month nothing is erased; of ended jobs of all keys there are counts
KEPT = {"keys", "monthly_usage", "removed_jobs"}


@pytest.fixture(params=["embedded", "scaled"])
def api(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Api]:
    settings = Settings(data_dir=tmp_path / "data", reap_interval_s=3600)
    if request.param == "embedded":
        yield from serve(settings)
        return
    with fresh_parts(request) as others:
        yield from serve(settings.model_copy(update=others))


def run(api: Api, *arguments: str, code: int = 0) -> str:
    done = attempt(api, *arguments)
    assert done.exit_code == code, (done.output, done.exception)
    return done.output


def attempt(api: Api, *arguments: str) -> Result:
    settings = api.services.settings
    environment = {
        "PVG_DATA_DIR": str(settings.data_dir),
        "PVG_DATABASE_URL": settings.database_url,
        "PVG_STORAGE_URL": settings.storage_url,
        "PVG_BROKER_URL": settings.broker_url,
    }
    return CliRunner().invoke(cli, ["keys", *arguments], env=environment)


class Customer:
    """A key with some of everything, all of it marked with a name of its own."""

    def __init__(self, api: Api, mark: str) -> None:
        self.api, self.mark, self.holder = api, mark, holder(api)
        self.id = self.holder.id
        self._number = 0
        video, reference = self._upload("videos"), self._upload("references")
        self._vectorizing(claimed=True)
        self._vectorizing(claimed=False)
        for one in (video, reference):
            make_ready(api.services, one)
        results = self._job(video, reference)
        make_results(api.services, results, [self._bytes()], parts=[("look.cube", 1, self._bytes())])
        self._running(self._job(video, reference))
        self._in_parts(self._job(video, reference), video)
        self._job(video, reference)
        self._unfinished_upload()
        self._preview(video, reference)

    def _bytes(self) -> bytes:
        return f"<{self.mark}>".encode() * 500

    def _upload(self, path: str) -> str:
        self._number += 1
        content = (MP4 if path == "videos" else PNG) + self._bytes() + bytes([self._number])
        files = {"file": (f"{self.mark}.mp4", content)}
        sent = self.holder.post(f"/{path}", files=files, data={"metadata": f"of:{self.mark}"})
        assert sent.status_code == 202, sent.text
        return str(sent.json()["id"])

    def _vectorizing(self, *, claimed: bool) -> None:
        medium = self._upload("videos")
        if claimed:
            claim(self.api.services.background, self.holder.get(f"/videos/{medium}").json()["job"], 3600)

    def _job(self, video: str, reference: str) -> str:
        """A transfer, which is asked for by an Idempotency-Key, and of whose end a receiver is to be told."""
        self._number += 1
        wanted = {
            "video": video,
            "looks": [{"reference": reference, "seed": self._number}],
            "metadata": {"of": self.mark},
        }
        made = self.holder.post("/transfer", json=wanted, headers={"Idempotency-Key": f"{self.mark}-{self._number}"})
        assert made.status_code == 202, made.text
        job_id = str(made.json()["id"])
        database = self.api.services.background
        with database.write() as session:
            job = jobs.get(session, job_id)
            assert job is not None
            webhooks.announce(session, job, f"https://receiver.invalid/{self.mark}", now=database.now())
            webhooks.secret(session, self.id, now=database.now())
        return job_id

    def _put(self, kind: str, name: str, **more: Any) -> str:
        services = self.api.services
        draft = services.storage.spool.draft()
        draft.write_bytes(self._bytes())
        key = services.storage.key(kind, "0" * 64, name, ".mp4")
        services.blobs.put(draft, key, **more)
        return key

    def _running(self, job_id: str) -> None:
        """A worker has just written a result that it has not recorded yet."""
        lease = claim(self.api.services.background, job_id, 3600)
        self.written = self._put("result", f"res_{job_id.removeprefix('job_')}", lease=lease)

    def _in_parts(self, job_id: str, video: str) -> None:
        database = self.api.services.background
        lease = claim(database, job_id, 3600)
        with database.write() as session:
            wanted = [NewPart(video, start, start + 100) for start in (0, 100)]
            made = parts.split(session, lease, wanted, now=database.now(), timings={})
        assert made is not None
        file = NewFile(0, self._put("drawn", made[0].job_id), 10)
        done = claim(database, made[0].job_id, 3600)
        with database.write() as session:
            assert parts.finish(session, done, [file], now=database.now(), timings={}) == []

    def _unfinished_upload(self) -> None:
        about = said(filename=f"{self.mark}.mp4", **{"metadata.of": self.mark})
        made = self.holder.post("/uploads", headers=TUS | {"Upload-Length": "300000", "Upload-Metadata": about})
        assert made.status_code == 201, made.text
        sent = self.holder.send(
            "PATCH", made.headers["location"], content=MP4 + self._bytes(), headers=PIECE | {"Upload-Offset": "0"}
        )
        assert sent.status_code == 204, sent.text

    def _preview(self, video: str, reference: str) -> None:
        database = self.api.services.background
        with database.write() as session:
            asked, _ = previews.ask(
                session,
                StillRequest("jpeg", 640, frame=3, params=LookParams()),
                owner=self.id,
                media_id=video,
                reference_id=reference,
                fingerprint="0" * 64,
                now=database.now(),
                within_s=60,
            )
            assert previews.take(session, asked.id, now=database.now(), within_s=60)
        key = self._put("preview", asked.id)
        with database.write() as session:
            assert previews.finish(session, asked.id, Still(key, 10, 3))

    def ids(self) -> set[str]:
        """Of all of its records."""
        with self.api.services.database.read() as session:
            owned = (one for one in Base.metadata.sorted_tables if "owner" in one.c and "id" in one.c)
            mine = (select(table.c.id).where(table.c.owner == self.id) for table in owned)
            return {one for ids in mine for one in session.scalars(ids)}

    def rows(self, names: set[str]) -> dict[str, list[str]]:
        """Those that name it, or one of its things."""
        found = all_rows(self.api)
        return {
            table: mine
            for table, rows in found.items()
            if table not in KEPT and (mine := [row for row in rows if any(name in row for name in names)])
        }


def all_rows(api: Api) -> dict[str, list[str]]:
    with api.services.database.read() as session:
        return {
            table.name: sorted(str(tuple(row)) for row in session.execute(select(table)))
            for table in Base.metadata.sorted_tables
        }


def months(api: Api, owner: str) -> ledger.Month:
    with api.services.database.read() as session:
        return ledger.months(session, owner, now=api.services.database.now())[0]


def contents(api: Api, request: pytest.FixtureRequest) -> list[bytes]:
    """Of all files: what they hold, and their names."""
    kept = list(contents_below(api.services.settings.folder))
    kept += [str(path).encode() for path in files_below(api.services.settings.folder)]
    if api.services.settings.storage_url.startswith("s3://"):
        bucket: S3 = request.getfixturevalue("shared_bucket")
        kept += [*bucket.contents(), *(key.encode() for key in bucket.listed())]
    return kept


@contextmanager
def interrupted(owner: Any, name: str, after: int) -> Iterator[None]:
    """The command's process ends when this is called once more than so many times; a storage is away then."""
    error: BaseException = OSError("away") if owner is Storage else KeyboardInterrupt()
    real, calls = getattr(owner, name), []

    def call(*arguments: Any, **more: Any) -> Any:
        calls.append(name)
        if len(calls) > after:
            raise error
        return real(*arguments, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, call)
        yield


SAID = "4 video(s) and reference(s), 2 result(s), 10 job(s), 1 upload(s) in pieces, 4 delivery(ies) of webhooks"


def check_gone(api: Api, left: Customer, names: set[str], request: pytest.FixtureRequest) -> None:
    """Nothing names the customer or one of its things but what is kept, and what a worker may be writing still."""

    def remains() -> object:
        """While others look into SQLite its log stays, and a message may be on its way: the next round sees to them."""
        api.services.reaper.round()
        rows = {table: found for table, found in left.rows(names).items() if table != "tombstones"}
        held = [name for name in names for content in contents(api, request) if name.encode() in content]
        return rows, sorted(set(held) - {left.id})

    until(lambda: remains() == ({}, []), said=remains)
    with api.services.database.read() as session:
        assert not belongings.count(session, left.id)
        assert set(session.scalars(select(Tombstone.blob_key))) & set(api.blobs) <= set(api.blobs) - {left.written}
    assert left.written not in api.blobs


def test_nothing_of_an_erased_key_is_left_and_all_of_another_one_s(api: Api, request: pytest.FixtureRequest) -> None:
    staying = Customer(api, "mark-of-who-stays")
    blobs = api.blobs
    leaving = Customer(api, "mark-of-who-leaves")
    names, names_of_other = ({one.id, one.mark, *one.ids()} for one in (leaving, staying))
    before = leaving.rows(names)
    assert {"media", "jobs", "looks", "results", "deliveries", "resumable_uploads", "upload_parts"} <= before.keys()
    assert {"parts", "part_files", "previews", "webhook_secrets", "idempotent_requests"} <= before.keys()
    assert sum(leaving.mark.encode() in content for content in contents(api, request)) >= len(blobs) - 2  # but assets

    assert "keys revoke" in run(api, "erase", leaving.id, "--for-good", code=2)
    run(api, "revoke", leaving.id)
    asked = run(api, "erase", leaving.id, code=1)
    assert f"{leaving.id} owns {SAID}" in asked
    assert "--for-good" in asked
    assert leaving.rows(names).keys() == before.keys()

    kept, done = staying.rows(names_of_other), months(api, leaving.id)
    assert run(api, "erase", leaving.id, "--for-good").startswith(SAID)
    assert api.blobs == blobs
    check_gone(api, leaving, names, request)
    after = staying.rows(names_of_other)
    assert {table: len(rows) for table, rows in after.items()} == {table: len(rows) for table, rows in kept.items()}
    assert [len(staying.holder.get(path).json()["data"]) for path in ("/videos", "/references", "/jobs")] == [3, 1, 8]
    counted = months(api, leaving.id)
    assert (counted.uploads, counted.upload_bytes, counted.looks) == (done.uploads, done.upload_bytes, done.looks)
    assert counted.jobs == {"succeeded": 3, "canceled": 5}
    assert leaving.holder.get("/videos").status_code == 401
    assert leaving.id in run(api, "list")


@pytest.mark.parametrize(
    ("owner", "name", "after"),
    [
        (belongings, "remove_deliveries", 1),
        (belongings, "remove_medium", 2),
        (belongings, "remove_job", 3),
        (belongings, "remove_rest", 0),
        (Blobs, "sweep", 0),
        (Storage, "delete", 2),
    ],
)
def test_what_an_erasure_that_was_ended_has_left_goes_with_the_next_one(
    api: Api, owner: Any, name: str, after: int, request: pytest.FixtureRequest
) -> None:
    leaving = Customer(api, "mark-of-who-leaves")
    names = {leaving.id, leaving.mark, *leaving.ids()}
    run(api, "revoke", leaving.id)
    with interrupted(owner, name, after):
        assert attempt(api, "erase", leaving.id, "--for-good").exit_code != 0
    until(lambda: attempt(api, "erase", leaving.id, "--for-good").exit_code == 0)
    assert api.blobs == []
    check_gone(api, leaving, names, request)
    assert run(api, "erase", leaving.id, "--for-good").startswith("0 video(s)")
    assert "no key nobody" in run(api, "erase", "nobody", "--for-good", code=2)


def test_what_a_request_brings_whose_key_is_revoked_meanwhile_is_not_recorded(api: Api) -> None:
    """It would be there after all was erased."""
    customer = Customer(api, "mark-of-who-leaves")
    video = customer.holder.get("/videos?state=ready").json()["data"][0]["id"]
    database, real = api.services.background, api.services.calls.write
    begun: list[str] = []

    async def revoke_before(work: Any, *arguments: Any, **more: Any) -> Any:
        if not begun and getattr(work, "__name__", "") != "_begin":
            begun.append(str(work))
            with database.write() as session:
                assert keys.revoke(session, session.get_one(Key, customer.id), now=database.now())
        return await real(work, *arguments, **more)

    for path, sent in (
        ("/videos", {"content": MP4 + b"another"}),
        ("/videos", {"content": MP4 + customer._bytes() + bytes([1])}),
        ("/transfer", {"json": {"video": video, "looks": [{"reference": video}]}}),
        ("/uploads", {"headers": TUS | {"Upload-Length": "300000", "Upload-Metadata": said(filename="x")}}),
    ):
        begun.clear()
        with database.write() as session:
            session.get_one(Key, customer.id).revoked_at = None
        before = customer.ids()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(type(api.services.calls), "write", lambda _, *given, **more: revoke_before(*given, **more))
            answer = customer.holder.post(path, **sent)
        assert (answer.status_code, len(begun)) == (401, 1), (path, answer.text)
        assert "revoked meanwhile" in answer.json()["detail"]
        assert customer.ids() == before
