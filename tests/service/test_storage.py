from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Collection
from datetime import UTC, datetime
from pathlib import Path

import pytest

from service.settings import Settings
from service.storage import BlobMissingError, Storage, file_sha256


@pytest.fixture(params=["folder", "object store"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    """Blobs in a local folder, and in a store that has no paths."""
    url = "" if request.param == "folder" else "memory:///"
    return Storage(Settings(data_dir=tmp_path, storage_url=url))


def add(storage: Storage, content: bytes) -> str:
    draft = storage.draft(".mp4")
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


def test_a_deleted_blob_is_missing_everywhere(storage: Storage) -> None:
    key = add(storage, b"x")
    storage.delete(key)
    storage.delete(key)
    assert list(storage.entries()) == []
    with pytest.raises(BlobMissingError):
        read(storage, key, 0, 1)
    with pytest.raises(BlobMissingError), storage.local_path(key):
        pass


def test_a_probe_leaves_nothing(storage: Storage) -> None:
    storage.ping()
    assert list(storage.entries()) == []


def test_a_local_copy_of_a_remote_blob_is_removed(tmp_path: Path) -> None:
    storage = Storage(Settings(data_dir=tmp_path, storage_url="memory:///"))
    key = add(storage, b"x")
    with storage.local_path(key) as path:
        assert path.exists()
    assert not path.exists()
    assert list((tmp_path / "spool").iterdir()) == []


def test_only_old_drafts_are_cleared(storage: Storage) -> None:
    old, new = storage.draft(), storage.draft()
    old.write_bytes(b"x")
    new.write_bytes(b"x")
    os.utime(old, (time.time() - 100, time.time() - 100))
    assert storage.clear_drafts(held=set, before=datetime.fromtimestamp(time.time() - 50, UTC)) == 1
    assert (old.exists(), new.exists()) == (False, True)


def test_drafts_of_jobs_that_nobody_holds_are_cleared(storage: Storage) -> None:
    ids = [f"job_{number:032x}" for number in range(2)]
    drafts = [storage.draft(".pvg", job_id=one) for one in ids]
    for draft in drafts:
        draft.write_bytes(b"x")
    asked: list[set[str]] = []

    def held(job_ids: Collection[str]) -> set[str]:
        asked.append(set(job_ids))
        return {ids[0]}

    assert storage.clear_drafts(held=held, before=datetime.fromtimestamp(0, UTC)) == 1
    assert asked == [set(ids)]
    assert [draft.exists() for draft in drafts] == [True, False]
