"""Files of folders that others write to meanwhile."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
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
