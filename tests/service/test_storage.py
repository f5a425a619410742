from __future__ import annotations

import asyncio
import errno
import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from obstore.exceptions import BaseError

from service import copying
from service import storage as storage_module
from service.copying import file_sha256, part_bytes
from service.outages import is_outage
from service.settings import Settings
from service.storage import BlobMissingError, Storage, client_options
from tests.service.remote import PRIVATE, Answer
from tests.service.remote import remote as server
from tests.service.s3 import PAGE, S3


@pytest.fixture(params=["folder", "s3"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    """Blobs in a local folder, and in a bucket below a prefix."""
    url = "" if request.param == "folder" else request.getfixturevalue("bucket").storage_url
    return Storage(Settings(data_dir=tmp_path, storage_url=url))


@pytest.fixture
def remote(bucket: S3, tmp_path: Path) -> Storage:
    return Storage(Settings(data_dir=tmp_path, storage_url=bucket.storage_url))


def add(storage: Storage, content: bytes) -> str:
    draft = storage.spool.draft(".mp4")
    draft.write_bytes(content)
    key = storage.key("source", file_sha256(draft), "vid_1", ".mp4")
    storage.put(draft, key)
    assert not draft.exists()
    return key


def read(storage: Storage, key: str, start: int, end: int) -> bytes:
    async def collect() -> bytes:
        return b"".join([piece async for piece in await storage.stream(key, start, end)])

    return asyncio.run(collect())


def test_a_blob_comes_back_whole_in_parts_and_as_a_file(storage: Storage) -> None:
    content = os.urandom(1_500_000)
    key = add(storage, content)
    assert read(storage, key, 0, len(content)) == content
    assert read(storage, key, 1000, 700_001) == content[1000:700_001]
    with storage.local_path(key) as path:
        assert path.suffix == ".mp4"
        assert path.read_bytes() == content
    assert [found for found, _ in storage.entries()] == [key]


def test_a_blob_of_several_parts_of_an_upload_is_one(remote: Storage, bucket: S3) -> None:
    content = os.urandom(12 * 1024**2 + 1)  # obstore sends parts of 5 MiB
    key = add(remote, content)
    assert bucket.listed() == [f"faces/{key}"]
    assert bucket.client().head_object(Bucket=bucket.bucket, Key=f"faces/{key}")["ETag"].strip('"').endswith("-3")
    edge = 5 * 1024**2
    assert read(remote, key, edge - 10, edge + 10) == content[edge - 10 : edge + 10]
    with remote.local_path(key) as path:
        assert path.read_bytes() == content
    assert httpx.get(str(remote.link(key, expires_in=timedelta(minutes=1))), timeout=60).content == content


@pytest.mark.parametrize("size", [0, 5 * 1024**2, 10_000 * 5 * 1024**2, 10_000 * 5 * 1024**2 + 1, 128 * 1024**3])
def test_a_file_of_any_size_has_no_more_parts_than_s3_takes(size: int) -> None:
    assert part_bytes(size) >= 5 * 1024**2
    assert part_bytes(size) * 10_000 >= size


def test_what_is_written_twice_is_what_was_written_last(storage: Storage) -> None:
    key = add(storage, b"first")
    draft = storage.spool.draft()
    draft.write_bytes(b"second")
    storage.put(draft, key)
    assert read(storage, key, 0, 6) == b"second"
    assert [found for found, _ in storage.entries()] == [key]


def test_every_page_of_a_listing_is_read(remote: Storage, bucket: S3) -> None:
    client = bucket.client()
    for number in range(PAGE + 5):
        client.put_object(Bucket=bucket.bucket, Key=f"faces/part/{number}", Body=b"")
    client.put_object(Bucket=bucket.bucket, Key="of-others", Body=b"")
    found = list(remote.entries())
    assert len({key for key, _ in found}) == len(found) == PAGE + 5
    assert all(abs(when - datetime.now(UTC)) < timedelta(hours=1) for _, when in found)


def test_a_store_that_refuses_the_credentials_is_away(remote: Storage, bucket: S3, tmp_path: Path) -> None:
    draft = remote.spool.draft()
    draft.write_bytes(b"x")
    with bucket.checking_signatures() as known:
        for call in (remote.ping, lambda: remote.put(draft, "source/a"), lambda: remote.delete("source/a")):
            with pytest.raises(BaseError) as raised:
                call()
            assert is_outage(raised.value), raised.value
        with pytest.MonkeyPatch.context() as patch:
            for name, value in known.environment().items():
                patch.setenv(name, value)
            Storage(Settings(data_dir=tmp_path, storage_url=bucket.storage_url)).ping()
    assert draft.exists()


def test_a_bucket_that_is_not_there_is_an_outage_and_no_lost_file(s3: S3, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in s3.environment().items():
            patch.setenv(name, value)
        storage = Storage(Settings(data_dir=tmp_path, storage_url="s3://nobody-made-this/faces"))
        draft = storage.spool.draft()
        draft.write_bytes(b"x")
        calls: tuple[Callable[[], object], ...] = (
            storage.ping,
            lambda: storage.put(draft, "source/a"),
            lambda: storage.delete("source/a"),
            lambda: storage.exists("source/a"),
            lambda: read(storage, "source/a", 0, 1),
            lambda: storage.local_path("source/a").__enter__(),
            lambda: list(storage.entries()),
        )
        for number, call in enumerate(calls):
            with pytest.raises(BaseError) as raised:
                call()
            assert is_outage(raised.value), (number, raised.value)
        assert draft.exists()


def slowly(pieces: int, *, of: int, stays: threading.Event, status: str = "200 OK") -> Answer:
    """An answer of a store that gives a piece of 1000 bytes now and then, and after so many of them nothing."""
    size = 1000 * of
    head = f'Content-Length: {size}\r\nLast-Modified: Wed, 21 Oct 2015 07:28:00 GMT\r\nETag: "1"\r\n'
    if status.startswith("206"):
        head += f"Content-Range: bytes 0-{size - 1}/{size}\r\n"

    def answer(connection: socket.socket) -> None:
        connection.sendall(f"HTTP/1.1 {status}\r\n{head}\r\n".encode())
        for _ in range(pieces):
            connection.sendall(bytes(1000))
            time.sleep(0.2)
        if pieces < of:
            stays.wait(60)

    return answer


def test_a_transfer_may_take_as_long_as_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All that took longer than 30 s was cut; now what stands still for so long is."""
    monkeypatch.setattr(storage_module, "_PATIENCE", storage_module._PATIENCE | {"read_timeout": "2s"})
    stays = threading.Event()
    with server(PRIVATE) as store:
        for name, value in S3(f"http://{PRIVATE}:{store.port}").environment().items():
            monkeypatch.setenv(name, value)
        one = Storage(Settings(data_dir=tmp_path, storage_url="s3://faces"))
        store.answers["/faces/whole"] = slowly(15, of=15, stays=stays)
        store.answers["/faces/range"] = slowly(15, of=15, stays=stays, status="206 Partial Content")
        store.answers["/faces/stands-still"] = slowly(1, of=15, stays=stays)
        try:
            with one.local_path("whole") as path:
                assert path.stat().st_size == 15_000
            assert len(read(one, "range", 0, 15_000)) == 15_000
            began = time.monotonic()
            with pytest.raises(BaseError) as caught, one.local_path("stands-still"):
                pass
            assert is_outage(caught.value)
            assert time.monotonic() - began < 25
        finally:
            stays.set()


def test_what_the_environment_says_of_speaking_to_a_store_holds() -> None:
    usual = client_options({"AWS_ALLOW_HTTP": "", "AWS_REGION": "eu-central-1"})
    assert usual == {"timeout": "1day", "read_timeout": "30s"}
    said = {"AWS_ALLOW_HTTP": "true", "AWS_READ_TIMEOUT": "2min", "AWS_PROXY_URL": "http://proxy:3128"}
    assert client_options(said) == usual | {
        "allow_http": "true",
        "read_timeout": "2min",
        "proxy_url": "http://proxy:3128",
    }


def test_a_deleted_blob_is_missing_everywhere(storage: Storage) -> None:
    key = add(storage, b"x")
    storage.delete(key)
    storage.delete(key)
    assert list(storage.entries()) == []
    with pytest.raises(BlobMissingError):
        read(storage, key, 0, 1)
    with pytest.raises(BlobMissingError), storage.local_path(key):
        pass


def unmount(folder: Path) -> Path:
    """Leave an empty mount point; where its disk is now."""
    folder.rename(disk := folder.with_name("disk"))
    folder.mkdir()
    return disk


@pytest.mark.parametrize("seen", [True, False], ids=["seen before", "in the records alone"])
def test_a_folder_that_is_not_mounted_is_an_outage_and_no_lost_file(tmp_path: Path, seen: bool) -> None:
    folder = tmp_path / "blobs"
    settings = Settings(data_dir=tmp_path / "data", storage_url=str(folder))
    storage = Storage(settings)
    storage.set_mark("one 0\n")
    key = add(storage, b"a face")
    if not seen:
        storage = Storage(settings, was_marked=lambda: True)
    disk = unmount(folder)
    draft = storage.spool.draft()
    draft.write_bytes(b"another face")

    def open_it() -> None:
        with storage.local_path(key):
            pass

    for call in (
        open_it,
        storage.ping,
        lambda: storage.exists(key),
        lambda: storage.delete(key),
        lambda: storage.put(draft, key),
        lambda: read(storage, key, 0, 1),
    ):
        with pytest.raises(BaseError, match="not mounted") as caught:
            call()
        assert is_outage(caught.value)
    assert list(folder.iterdir()) == []
    folder.rmdir()
    disk.rename(folder)
    assert read(storage, key, 0, 6) == b"a face"
    storage.put(draft, key)
    storage.ping()


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EHOSTDOWN, errno.ENOTCONN])
def test_a_folder_whose_server_does_not_answer_is_an_outage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    storage = Storage(Settings(data_dir=tmp_path))
    key = add(storage, b"a face")
    draft = storage.spool.draft()
    draft.write_bytes(b"another face")

    def fail(*_: object, **__: object) -> os.stat_result:
        raise OSError(number, os.strerror(number))

    def open_it() -> None:
        with storage.local_path(key):
            pass

    monkeypatch.setattr(Path, "stat", fail)
    for call in (open_it, storage.ping, lambda: storage.put(draft, key)):
        with pytest.raises(BaseError) as caught:
            call()
        assert is_outage(caught.value)


def test_a_probe_leaves_nothing(storage: Storage) -> None:
    storage.ping()
    assert list(storage.entries()) == []


def test_a_local_copy_of_a_remote_blob_is_removed(remote: Storage, tmp_path: Path) -> None:
    key = add(remote, b"x")
    with remote.local_path(key) as path:
        assert path.exists()
    assert not path.exists()
    assert list((tmp_path / "spool").iterdir()) == []


def test_only_old_drafts_are_cleared(storage: Storage) -> None:
    old, new = storage.spool.draft(), storage.spool.draft()
    old.write_bytes(b"x")
    new.write_bytes(b"x")
    os.utime(old, (time.time() - 100, time.time() - 100))
    assert storage.spool.clear_drafts(held=set, before=datetime.fromtimestamp(time.time() - 50, UTC)) == 1
    assert (old.exists(), new.exists()) == (False, True)


def test_drafts_of_jobs_that_nobody_holds_are_cleared(storage: Storage) -> None:
    ids = [f"job_{number:032x}" for number in range(2)]
    drafts = [storage.spool.draft(".pvg", job_id=one) for one in ids]
    for draft in drafts:
        draft.write_bytes(b"x")
    asked: list[set[str]] = []

    def held(job_ids: Collection[str]) -> set[str]:
        asked.append(set(job_ids))
        return {ids[0]}

    assert storage.spool.clear_drafts(held=held, before=datetime.fromtimestamp(0, UTC)) == 1
    assert asked == [set(ids)]
    assert [draft.exists() for draft in drafts] == [True, False]


def test_a_folder_of_drafts_is_cleared_with_its_files(storage: Storage) -> None:
    folder = storage.spool.draft(job_id=f"job_{0:032x}")
    folder.mkdir()
    (folder / "matte.mkv").write_bytes(b"x")
    assert storage.spool.clear_drafts(held=lambda _: (), before=datetime.fromtimestamp(0, UTC)) == 1
    assert not folder.exists()


def test_credentials_of_a_store_may_be_in_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, secret in (("AWS_ACCESS_KEY_ID", "OURKEY"), ("AWS_SECRET_ACCESS_KEY", "c" * 40)):
        (tmp_path / name).write_text(secret + "\n")
        monkeypatch.setenv(f"{name}_FILE", str(tmp_path / name))
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_REGION", "eu-central-1")
    store = Storage(Settings(data_dir=tmp_path, storage_url="s3://bucket/prefix"))
    link = store.link("result/x", expires_in=timedelta(seconds=60))  # signed here, with what is in the files
    assert link is not None
    assert "X-Amz-Credential=OURKEY%2F" in link


KEY = f"source/ab/ab{'0' * 62}-vid_{'0' * 32}.mp4"


@pytest.fixture
def other_disk(tmp_path: Path) -> Iterator[Path]:
    """A folder on another disk than that of the test."""
    for parent in (Path("/dev/shm"), Path.home()):
        if parent.is_dir() and parent.stat().st_dev != tmp_path.stat().st_dev:
            with tempfile.TemporaryDirectory(dir=parent) as folder:
                yield Path(folder)
            return
    pytest.skip("this machine has one disk")


def drafted(blobs: Path, tmp_path: Path) -> tuple[Storage, Path]:
    """A storage of this folder, and a draft in it."""
    storage = Storage(Settings(data_dir=tmp_path / "data", storage_url=str(blobs)))
    draft = storage.spool.draft()
    draft.write_bytes(b"a face")
    return storage, draft


class Killed(BaseException):
    """What nothing catches."""


def test_a_write_to_another_disk_that_is_killed_leaves_nothing_that_is_not_cleared(
    other_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The blobs on a disk of their own: pieces of a face were left there that no delete found."""
    blobs = other_disk / "blobs"
    storage, draft = drafted(blobs, tmp_path)

    def stopped(source: Path, target: Path, _: object) -> None:
        target.write_bytes(source.read_bytes()[:3])
        monkeypatch.setattr(Path, "unlink", lambda *_, **__: None)  # who is killed clears nothing up
        raise Killed

    monkeypatch.setattr(copying, "copy", stopped)
    with pytest.raises(Killed):
        storage.put(draft, KEY)
    monkeypatch.undo()
    (piece,) = (path for path in blobs.rglob("*") if path.is_file())
    assert list(storage.entries()) == [], "nothing partial is visible"
    now = datetime.now(UTC)
    assert storage.clear_incoming(before=now - timedelta(hours=1)) == 0, "somebody may be writing it"
    os.utime(piece, (time.time() - 3700,) * 2)
    assert storage.clear_incoming(before=now - timedelta(hours=1)) == 1
    storage.put(draft, KEY)
    assert [path for path in blobs.rglob("*") if path.is_file()] == [blobs / KEY]
    assert not draft.exists()


@pytest.fixture(params=["beside the drafts", "elsewhere"])
def blobs(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A folder of blobs on the disk of the drafts, and on another one."""
    return (request.getfixturevalue("other_disk") if request.param == "elsewhere" else tmp_path) / "blobs"


def test_a_blob_is_on_the_disk_before_it_has_its_name_and_its_name_before_it_is_known(
    blobs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage, draft = drafted(blobs, tmp_path)
    synced: list[str] = []
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        synced.append("." if path == blobs else "file" if path.is_file() else path.relative_to(blobs).as_posix())
        if path.is_file():
            assert path.read_bytes() == b"a face"
            assert not (blobs / KEY).exists()
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    storage.put(draft, KEY)
    assert synced.index("file") < synced.index("source/ab")
    assert {"source", "."} <= set(synced), "of folders that are new as well"
    assert synced[-1] == "source/ab"


def test_a_blob_whose_name_could_not_be_made_sure_is_published_by_the_next_try(
    blobs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage, draft = drafted(blobs, tmp_path)
    fsync = os.fsync

    def stale(descriptor: int) -> None:
        if Path(os.readlink(f"/proc/self/fd/{descriptor}")) == (blobs / KEY).parent and (blobs / KEY).exists():
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))
        fsync(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", stale)
        with pytest.raises(Exception, match=r"(?i)stale") as error:
            storage.put(draft, KEY)
        assert is_outage(error.value)
    storage.put(draft, KEY)
    assert (blobs / KEY).read_bytes() == b"a face"
    assert not draft.exists()
    with pytest.raises(FileNotFoundError):
        storage.put(draft, KEY.replace("source", "result"))


def test_pieces_that_former_versions_left_beside_blobs_go(tmp_path: Path) -> None:
    storage = Storage(Settings(data_dir=tmp_path))
    blobs = tmp_path / "blobs"
    for name in (KEY, f"{KEY}#1", f"{KEY}#12", "source/ab/of-others#1"):
        (blobs / name).parent.mkdir(parents=True, exist_ok=True)
        (blobs / name).write_bytes(b"x")
    assert storage.clear_former_pieces(before=datetime.now(UTC) - timedelta(hours=1)) == 0
    assert storage.clear_former_pieces(before=datetime.now(UTC) + timedelta(hours=1)) == 2
    assert {path.name for path in (blobs / "source" / "ab").iterdir()} == {Path(KEY).name, "of-others#1"}
