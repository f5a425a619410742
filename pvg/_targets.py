"""Where results are written: what cannot be, or would replace what is read, is refused before the work begins.

A name that does not fit is a ValueError, a place that cannot be written an OSError.
"""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterable
from pathlib import Path

STANDARD = Path("-")
"""Standard input or output, in the place of a file."""
_START_BYTES = 64  # of a name, which may have 255 and end in a suffix of 8
_LONGEST_SUFFIX = 8


def draft_of(path: Path) -> Path:
    """A name of its own beside `path`, to write under until all is there: hidden, with its start and its suffix."""
    start = os.fsencode(path.stem)[:_START_BYTES].decode("utf-8", "ignore")
    suffix = path.suffix if len(path.suffix) <= _LONGEST_SUFFIX else ""
    return path.with_name(f".{start}.{secrets.token_hex(8)}{suffix}")


def begin_draft(draft: Path, path: Path) -> None:
    """Make the empty draft that will replace `path`, closed to whomever what lies there now is closed to.

    So a file that `tempfile` has named is private from the first byte on. Raises FileExistsError where the draft is.
    """
    try:
        mode = path.stat().st_mode & 0o666 | 0o600  # what its owner may not write is replaced all the same
    except OSError:
        mode = 0o666
    draft.touch(mode, exist_ok=False)  # less what the umask takes


def check_file(path: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse a file that cannot be written or would replace one of the `inputs`."""
    _check_name(path)
    if path.is_dir():
        raise _os_error(errno.EISDIR, path)
    if path.exists():
        if not path.is_file():
            raise ValueError(f"{path} is not a regular file")
        if any(other is not None and other.exists() and path.samefile(other) for other in inputs):
            raise ValueError(f"{path} would be replaced while it is read; write to another name")
    if not path.parent.exists():
        raise _os_error(errno.ENOENT, path.parent)
    check_folder(path.parent)


def check_files(paths: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """The same of several files, no two of which may be one, however they are spelled."""
    inputs, seen = list(inputs), set[Path]()
    for path in paths:
        check_file(path, inputs)
        place = path.parent.resolve() / path.name  # a link is replaced, not what it leads to
        if place in seen:
            raise ValueError(f"two results would be written to the same path, {path}")
        seen.add(place)


def check_folder(path: Path) -> None:
    """Refuse a folder that cannot be made or written to."""
    _check_name(path)
    found = next(one for one in (path, *path.absolute().parents) if one.exists())
    if not found.is_dir():
        raise _os_error(errno.ENOTDIR, found)
    if not os.access(found, os.W_OK | os.X_OK):
        raise _os_error(errno.EACCES, found)


def check_folder_of_files(path: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse a folder whose files are all written anew where it cannot be, or has one of the `inputs` in it."""
    check_folder(path)
    if any(other is not None and other.parent.resolve() == path.resolve() for other in inputs):
        raise ValueError(f"files in {path} would be replaced while they are read; write to another folder")


def _check_name(path: Path) -> None:
    """Refuse what no file can be called, of which is told elsewhere that it is not there."""
    if "\0" in str(path):
        raise ValueError(f"{str(path)!r} has a NUL in it, which no name of a file has")


def _os_error(number: int, path: Path) -> OSError:
    return OSError(number, os.strerror(number), str(path))
