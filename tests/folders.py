"""Files of folders that others write to meanwhile."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def files_below(folder: Path) -> list[Path]:
    """Every file of a folder and those in it. Other than rglob it bears folders that go away meanwhile."""
    walked = (Path(root, name) for root, _, names in os.walk(folder) for name in names)
    return [path for path in walked if path.is_file()]


def contents_below(folder: Path) -> Iterator[bytes]:
    """What each of them holds, but for those that go away meanwhile."""
    for path in files_below(folder):
        with suppress(FileNotFoundError):
            yield path.read_bytes()


def permissions(path: Path) -> int:
    """Who may do what with a file or folder, as `chmod` takes it."""
    return stat.S_IMODE(path.stat().st_mode)


@contextmanager
def umask_of(mask: int) -> Iterator[None]:
    """What this process makes meanwhile lacks these permissions."""
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)
