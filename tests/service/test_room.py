"""Room on the disk, as an event loop asks for it."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import pytest

from service.errors import StorageFullError
from service.queue import make_folders
from service.room import Room
from service.settings import Settings
from tests.service.fixtures import PNG, Api


def test_a_folder_that_hangs_holds_up_no_request(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """A shared folder whose server is away answers nothing, for minutes."""
    asked, back, real = threading.Event(), threading.Event(), os.statvfs

    def hangs(path: Any) -> os.statvfs_result:
        asked.set()
        back.wait(60)
        return real(path)

    monkeypatch.setattr("service.room.os.statvfs", hangs)
    try:
        assert asked.wait(60)
        assert api.client.get("/livez", timeout=20).status_code == 200
        file: dict[str, Any] = {"content": PNG + os.urandom(3_000_000), "headers": {"content-type": "image/png"}}
        assert api.client.post("/references", timeout=20, **file).status_code == 202
        assert api.client.get("/livez", timeout=20).status_code == 200
        assert api.client.get("/metrics", timeout=20).status_code == 200
    finally:
        back.set()
    assert api.drafts == []


def test_what_is_written_between_two_looks_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.room._LOOK_S", 600)
    settings = Settings(data_dir=tmp_path / "data", min_free_bytes=100)
    make_folders(settings)
    room, free = Room(settings), 1000
    monkeypatch.setattr("service.room._free", lambda _: free)
    room.watch()
    room.take(600)
    with pytest.raises(StorageFullError):
        room.take(600)
    room._look()  # what is written by now is gone from what is free
    room.take(600)
    room.unwatch()
