"""Which clips stay open, with real processes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from service.catalog import Media
from service.settings import Settings
from service.storage import Storage
from tests.waiting import until
from tests.worker.sandbox.test_sandbox import server
from worker.previews.open_clips import Clip, OpenClips
from worker.sandbox import MethodError, Sandbox, SandboxServer

__all__ = ["server"]


@pytest.fixture
def clips(tmp_path: Path, server: SandboxServer) -> Iterator[OpenClips]:
    settings = Settings(data_dir=tmp_path / "data", preview_open_clips=4)
    storage = Storage(settings)
    for number in range(6):
        for kind in ("source", "asset"):
            draft = storage.draft()
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
        draft = storage.draft()
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
