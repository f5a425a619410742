"""Folders that hold faces: open to their owner alone, as is every file that is written later."""

from __future__ import annotations

import errno
import os
import resource
import stat
from fnmatch import fnmatch
from pathlib import Path
from typing import Final

import structlog

log = structlog.get_logger(__name__)

#: the permission bits of group and others
OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
_OWN: Final = stat.S_IRWXU
#: what the service keeps in its folders; whatever else lies there is not ours to change
_CONTENTS: Final = (
    "blobs",
    "spool",
    "broker",
    "source",
    "asset",
    "pictures",
    "result",
    "preview",
    "part",
    "drawn",
    ".incoming",
    ".database",
    "link-secret*",
    "catalog.sqlite3*",
    "reserve",
)
#: what nobody else calls so; with PostgreSQL and Redis a data folder may have `spool` alone
_OWN_NAMES: Final = (".incoming", ".database", "link-secret*", "catalog.sqlite3*")
#: what a disk of its own has before anything is written
_OF_A_DISK: Final = {"lost+found"}


def keep_to_ourselves() -> None:
    """Whatever this process and its children create from now on is for their user alone: folders 0700, files 0600.

    Where they crash the kernel leaves no core file, in which the faces would be that they worked on. Who looks for a
    fault may raise the soft limit of the running process again (`prlimit --core`).
    """
    os.umask(OTHERS)
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def private_folder(folder: Path) -> None:
    """Make a folder that only its owner can enter, or see to it that the one that is there is such.

    What other users could enter is closed to them when it is ours, with what the service keeps in it. Raises
    `PermissionError` when it is another user's or meant for all, and `OSError` when it cannot be made, or would be
    closed though it has folders and nothing of the service's.
    """
    folder.mkdir(mode=_OWN, parents=True, exist_ok=True)
    found = folder.stat()
    if not found.st_mode & OTHERS:
        return
    if found.st_uid != os.geteuid() or found.st_mode & stat.S_ISVTX:
        raise PermissionError(
            errno.EACCES,
            "will hold faces, but other users may enter it and it is not ours to close: let its owner run `chmod 700`, "
            "or choose a folder inside it",
            str(folder),
        )
    _check_contents(folder)
    # from the top: once it is closed, nobody else reaches what is inside
    _close(folder)
    for name in _CONTENTS:
        for path in folder.glob(name):
            _close(path)
            for inner in path.rglob("*") if path.is_dir() else ():
                _close(inner)
    log.warning("other users could enter this folder; it is closed now", folder=str(folder))


def _check_contents(folder: Path) -> None:
    """Raise `OSError` for a folder of something else, such as one whose name was mistyped; a log lies in many."""
    found = [path.name for path in folder.iterdir()]
    folders = {name for name in found if (folder / name).is_dir()} - _OF_A_DISK
    is_ours = any(fnmatch(name, own) for name in found for own in _OWN_NAMES)
    # blobs of before 0.2 have none of these names
    is_like_ours = folders <= set(_CONTENTS) and ("spool" in folders or {"source", "asset"} <= folders)
    if folders and not is_ours and not is_like_ours:
        raise OSError(
            errno.ENOTEMPTY,
            "has folders and nothing of the service's, and would be closed to others: choose an empty folder, or one "
            "inside it that is not there yet",
            str(folder),
        )


def _close(path: Path) -> None:
    try:
        found = path.lstat()
        if found.st_uid == os.geteuid() and found.st_mode & OTHERS and not stat.S_ISLNK(found.st_mode):
            path.chmod(stat.S_IMODE(found.st_mode) & ~OTHERS)
    except FileNotFoundError:
        pass  # a draft that was just published
