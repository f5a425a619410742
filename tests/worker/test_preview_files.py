"""The file of a picture, which a process has made that somebody else's medium may have taken over."""

from __future__ import annotations

import errno
import os
import shutil
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from service.settings import Settings
from service.spool import Spool
from worker.previews.previewer import copied
from worker.sandbox import CrashError


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(data_dir=tmp_path / "data")


@pytest.fixture
def spool(settings: Settings) -> Spool:
    return Spool(settings.spool_folder)


def opened(folder: Path) -> list[str]:
    """What of a folder this process has open; threads of other tests may open and close other files."""
    found = []
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            found.append(os.readlink(f"/proc/self/fd/{name}"))
    return [path for path in found if path.startswith(str(folder))]


def test_the_draft_is_a_copy(spool: Spool, tmp_path: Path) -> None:
    made = tmp_path / "picture.jpg"
    made.write_bytes(b"picture")
    draft = copied(made, spool)
    made.write_bytes(b"another")
    assert draft.read_bytes() == b"picture"


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


def _second_name(path: Path) -> None:
    (path.parent / "first").write_bytes(b"of somebody else")
    os.link(path.parent / "first", path)


@pytest.mark.parametrize(
    "make",
    [os.mkfifo, os.mkdir, _socket, _second_name, lambda path: path.symlink_to("/dev/zero")],
    ids=["pipe", "folder", "socket", "second name", "link to a device"],
)
@pytest.mark.timeout(120)
def test_what_is_no_plain_file_is_refused(
    settings: Settings, spool: Spool, tmp_path: Path, make: Callable[[Path], object]
) -> None:
    make(tmp_path / "picture.jpg")
    with pytest.raises((CrashError, OSError)):
        copied(tmp_path / "picture.jpg", spool)
    assert opened(tmp_path) == []
    assert list(settings.spool_folder.iterdir()) == []


def test_a_full_disk_leaves_neither_draft_nor_descriptor(
    settings: Settings, spool: Spool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(source: object, target: object) -> None:
        raise OSError(errno.ENOSPC, "no space left on device")

    made = tmp_path / "picture.jpg"
    made.write_bytes(b"picture")
    with monkeypatch.context() as harm:
        harm.setattr(shutil, "copyfileobj", full)
        with pytest.raises(OSError, match="no space"):
            copied(made, spool)
    assert list(settings.spool_folder.iterdir()) == []
    settings.spool_folder.rmdir()
    with pytest.raises(FileNotFoundError):
        copied(made, spool)
    assert opened(tmp_path) == []
