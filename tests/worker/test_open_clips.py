"""Which clips stay open, with real processes."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.catalog import Media
from service.settings import Settings
from service.storage import BlobMissingError, Storage
from tests.folders import files_below
from tests.service.s3 import S3
from tests.service.servers import Wire
from tests.threads import own_threads
from tests.waiting import until
from tests.worker.sandbox.test_sandbox import server
from worker.previews.open_clips import Clip, OpenClips
from worker.sandbox import MethodError, Sandbox, SandboxServer, TimeLimitError

__all__ = ["server"]


@pytest.fixture
def clips(tmp_path: Path, server: SandboxServer) -> Iterator[OpenClips]:
    settings = Settings(data_dir=tmp_path / "data", preview_open_clips=4)
    storage = Storage(settings)
    for number in range(6):
        for kind in ("source", "asset"):
            draft = storage.spool.draft()
            draft.write_text(f"{kind} {number}")
            storage.put(draft, f"{kind}/{number}")
    made = OpenClips(settings, storage, Sandbox(server.lobby), lambda ids: {})
    yield made
    for entry in list(made._entries.values()):
        made._close(entry)


@pytest.mark.parametrize("where", ["folder", "s3"])
def test_what_is_wrong_with_a_clip_names_no_file(
    where: str, tmp_path: Path, request: pytest.FixtureRequest, warm_server: SandboxServer
) -> None:
    url = request.getfixturevalue("bucket").storage_url if where == "s3" else ""
    settings = Settings(data_dir=tmp_path / "data", storage_url=url)
    storage = Storage(settings)
    for key in ("source/aa/0123.png", "asset/aa/4567.pvg"):
        draft = storage.spool.draft()
        draft.write_text("damaged")
        storage.put(draft, key)
    medium = Media(id="vid_1", source_key="source/aa/0123.png", asset_key="asset/aa/4567.pvg")
    clips = OpenClips(settings, storage, Sandbox(warm_server.lobby), lambda ids: {})
    for clip in (Clip(medium, None), Clip(medium, medium)):
        with pytest.raises(MethodError, match=r"^the vectorised vid_1 is not an asset ") as raised:
            clips.ask(clip, {}, "picture.jpg", time.monotonic() + 120)
        assert raised.value.kind == "AssetError"
        assert "/" not in str(raised.value)
        assert "4567" not in str(raised.value)


def pid_of(clips: OpenClips, number: int) -> int:
    clip = Clip(Media(id=f"vid_{number}", source_key=f"source/{number}", asset_key=f"asset/{number}"), None)
    answer, _ = clips.ask(clip, {}, "picture.jpg", time.monotonic() + 60)
    assert answer["kept"] == f"source {number}"
    return int(answer["pid"])


def test_as_many_as_may_be_stay_open_and_the_one_longest_unused_goes(clips: OpenClips) -> None:
    pids = [pid_of(clips, number) for number in range(4)]
    assert [pid_of(clips, number) for number in range(4)] == pids
    fifth = pid_of(clips, 4)
    assert [pid_of(clips, number) for number in (1, 2, 3, 4)] == [*pids[1:], fifth]
    assert pid_of(clips, 0) != pids[0]


def test_a_clip_that_nobody_asks_about_for_a_while_is_closed(clips: OpenClips, monkeypatch: pytest.MonkeyPatch) -> None:
    steady_s = time.monotonic()
    monkeypatch.setattr("worker.previews.open_clips.time", SimpleNamespace(monotonic=lambda: steady_s))
    monkeypatch.setattr(clips, "_present", lambda ids: {one: one.replace("vid_", "asset/") for one in ids})
    first, second = pid_of(clips, 0), pid_of(clips, 1)
    steady_s += Settings().preview_idle_s - 1
    assert pid_of(clips, 1) == second
    clips._close_unneeded()
    assert pid_of(clips, 0) == first
    steady_s += Settings().preview_idle_s - 1
    assert pid_of(clips, 1) == second
    steady_s += 2
    clips._close_unneeded()
    assert [entry.clip.medium.id for entry in clips._entries.values()] == ["vid_1"]
    until(lambda: not Path(f"/proc/{first}").exists())


def test_clips_in_use_count_among_those_that_may_be_open(clips: OpenClips) -> None:
    for number in range(4):
        pid_of(clips, number)
    for entry in list(clips._entries.values())[:3]:
        entry.users += 1  # as while another thread asks
    pid_of(clips, 4)
    assert sorted(clip.medium.id for clip in (entry.clip for entry in clips._entries.values() if entry.session)) == [
        "vid_0",
        "vid_1",
        "vid_2",
        "vid_4",
    ]
    for entry in clips._entries.values():
        entry.users = 0


class CountingStorage(Storage):
    """Notes which blobs it is asked for."""

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self.asked: list[str] = []

    def local_path(self, key: str, **more: Any) -> AbstractContextManager[Path]:
        self.asked.append(key)
        return super().local_path(key, **more)


@dataclass
class Remote:
    """Clips whose files are in a bucket: their media, and the assets of those that are still there."""

    clips: OpenClips
    storage: CountingStorage
    spool: Path
    media: list[Media]
    present: dict[str, str | None] = field(default_factory=dict)

    def ask(self, *numbers: int, seconds: float = 60) -> str:
        """What the process has read of the file of the first of these media, with the other one as its reference."""
        medium, *reference = (self.media[number] for number in numbers)
        clip = Clip(medium, reference[0] if reference else None)
        answer, _ = self.clips.ask(clip, {}, "picture.jpg", time.monotonic() + seconds)
        return str(answer["kept"])

    def close(self) -> None:
        """Close what is open, as after a while without a question."""
        for entry in list(self.clips._entries.values()):
            self.clips._close(entry)

    @property
    def copies(self) -> list[str]:
        """What is said in the files that are kept or on their way, if anything is."""
        found = []
        for path in files_below(self.spool):
            with suppress(OSError):  # gone by now
                found.append(path.read_text())
        return sorted(found)


@contextmanager
def remote_clips(folder: Path, server: SandboxServer, url: str, **settings: Any) -> Iterator[Remote]:
    made = Settings(data_dir=folder / "data", storage_url=url, **settings)
    storage = CountingStorage(made)
    media = []
    for number in range(3):
        medium = Media(id=f"vid_{number}", source_key=f"source/{number}", asset_key=f"asset/{number}")
        for key in (medium.source_key, str(medium.asset_key)):
            draft = storage.spool.draft()
            draft.write_text(key)
            storage.put(draft, key)
        media.append(medium)
    present = {medium.id: medium.asset_key for medium in media}

    def assets(media_ids: set[str]) -> Mapping[str, str | None]:
        return {media_id: present[media_id] for media_id in media_ids if media_id in present}

    clips = OpenClips(made, storage, Sandbox(server.lobby), assets)
    remote = Remote(clips, storage, made.spool_folder, media, present)
    clips.start()
    try:
        yield remote
    finally:
        clips.stop()
        until(lambda: not remote.copies)


@pytest.fixture
def remote(tmp_path: Path, server: SandboxServer, bucket: S3, wire: Wire) -> Iterator[Remote]:
    with remote_clips(tmp_path, server, bucket.storage_url, preview_idle_s=3600) as remote:
        yield remote


def test_a_file_that_comes_too_late_for_one_question_is_there_for_the_next(remote: Remote, wire: Wire) -> None:
    wire.hang()
    with pytest.raises(TimeLimitError):
        remote.ask(0, seconds=1)
    threading.Timer(2, wire.connect).start()  # it is waited for by then
    assert remote.ask(0) == "source/0"
    assert sorted(remote.storage.asked) == ["asset/0", "source/0"]


def test_all_looks_of_a_clip_share_its_files_and_so_does_who_opens_it_again(remote: Remote) -> None:
    for numbers in ((0,), (0, 1), (0, 2)):
        assert remote.ask(*numbers) == "source/0"
    remote.close()
    assert remote.ask(0, 2) == "source/0"
    assert remote.ask(1, 0) == "source/1"
    assert sorted(remote.storage.asked) == ["asset/0", "asset/1", "asset/2", "source/0", "source/1"]


def test_several_who_wait_for_a_file_fetch_it_once(remote: Remote, wire: Wire) -> None:
    wire.hang()
    asking = [threading.Thread(target=remote.ask, args=numbers) for numbers in ((0, 1), (0, 2))]
    for thread in asking:
        thread.start()
    until(lambda: len(remote.storage.asked) == 4)
    wire.connect()
    for thread in asking:
        thread.join(60)
    assert sorted(remote.storage.asked) == ["asset/0", "asset/1", "asset/2", "source/0"]


def test_a_file_that_nobody_has_asked_for_for_long_goes(tmp_path: Path, server: SandboxServer, bucket: S3) -> None:
    with remote_clips(
        tmp_path, server, bucket.storage_url, preview_copy_idle_s=0.5, preview_timeout_s=0.1, preview_idle_s=3600
    ) as remote:
        remote.ask(0)
        remote.ask(1)
        time.sleep(3)
        assert remote.copies == ["asset/0", "asset/1", "source/0", "source/1"], "they are in use"
        (entry,) = (one for one in remote.clips._entries.values() if one.clip.medium.id == "vid_0")
        remote.clips._close(entry)
        until(lambda: remote.copies == ["asset/1", "source/1"])
        assert remote.ask(0) == "source/0"


def test_files_beyond_what_may_be_kept_go_the_one_longest_unused_first(
    tmp_path: Path, server: SandboxServer, bucket: S3
) -> None:
    few = len("source/0") + len("asset/0") + len("asset/1")
    with remote_clips(tmp_path, server, bucket.storage_url, preview_copy_bytes=few, preview_timeout_s=0.5) as remote:
        remote.ask(0)
        remote.close()
        remote.ask(1)
        remote.close()
        until(lambda: len(remote.copies) < 4)
        time.sleep(2)
        assert remote.copies == ["asset/0", "asset/1", "source/1"]


def test_a_disk_that_is_short_of_room_gets_them_back(
    tmp_path: Path, server: SandboxServer, bucket: S3, monkeypatch: pytest.MonkeyPatch
) -> None:
    with remote_clips(tmp_path, server, bucket.storage_url, preview_timeout_s=0.1) as remote:
        remote.ask(0)
        remote.close()
        time.sleep(2)
        assert remote.copies == ["asset/0", "source/0"]
        monkeypatch.setattr("service.room._free", lambda _: 0)
        until(lambda: not remote.copies)


@pytest.mark.parametrize("how", ["deleted", "vectorised anew"])
def test_nothing_is_kept_of_a_medium_that_is_deleted(remote: Remote, how: str) -> None:
    remote.ask(0, 1)
    if how == "deleted":
        del remote.present["vid_0"]
    else:
        remote.present["vid_0"] = "asset/9"
    until(lambda: remote.copies == ["asset/1"])
    assert len(remote.storage.asked) == 3


def test_nor_of_one_that_is_deleted_while_its_file_comes(remote: Remote, wire: Wire) -> None:
    wire.hang()
    with pytest.raises(TimeLimitError):
        remote.ask(0, seconds=0.5)
    until(lambda: files_below(remote.spool))
    remote.present.clear()
    until(lambda: not list(remote.spool.iterdir()))
    wire.connect()


def test_a_worker_that_stops_waits_for_no_file(tmp_path: Path, server: SandboxServer, bucket: S3, wire: Wire) -> None:
    copying = own_threads("copies")
    with remote_clips(tmp_path, server, bucket.storage_url) as remote:
        wire.hang()
        with pytest.raises(TimeLimitError):
            remote.ask(0, seconds=0.5)
    until(lambda: not list(remote.spool.iterdir()))
    until(lambda: not copying())
    wire.connect()


def test_a_file_that_a_store_has_lost_is_asked_for_again(remote: Remote, bucket: S3) -> None:
    remote.storage.delete("asset/0")
    for _ in range(2):
        with pytest.raises(BlobMissingError, match="asset/0"):
            remote.ask(0)
    draft = remote.storage.spool.draft()
    draft.write_text("asset/0")
    remote.storage.put(draft, "asset/0")
    assert remote.ask(0) == "source/0"
    assert remote.storage.asked.count("source/0") == 1


def test_files_of_a_folder_are_used_where_they_are(clips: OpenClips) -> None:
    pid_of(clips, 0)
    (entry,) = clips._entries.values()
    assert {path.read_text() for path in entry.keys} == {"source 0", "asset 0"}
    assert {str(path.relative_to(clips._settings.folder / "blobs")) for path in entry.keys} == {"source/0", "asset/0"}
    assert clips._copies is None
