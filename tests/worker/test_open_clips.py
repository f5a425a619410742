"""Which clips stay open, with real processes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.catalog import Media
from service.settings import Settings
from service.storage import Storage
from tests.worker.sandbox.test_sandbox import server
from worker.previews.open_clips import Clip, OpenClips
from worker.sandbox import Sandbox, SandboxServer

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
