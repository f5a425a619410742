"""Which file lies at a path: told surely by its bytes, and quickly by what else changes with them."""

from __future__ import annotations

import hashlib
from pathlib import Path

FileState = tuple[int, ...]


def file_state(path: Path) -> FileState:
    """What is another once the file was written to or replaced, as far as the clock tells.

    Raises OSError, and ValueError for a path that none can have.
    """
    found = path.stat()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def sha256_file(path: str | Path) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
