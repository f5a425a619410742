"""Drafts: files and folders that are being written, on a disk of this machine."""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Collection
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import IO

from service.ids import JOB_ID


class Spool:
    """The drafts of this machine, in a folder. Nobody sees them until they are published elsewhere."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._folder.mkdir(parents=True, exist_ok=True)

    def draft(self, suffix: str = "", *, job_id: str = "") -> Path:
        """A fresh temporary path to write a file, or a folder of files, at."""
        return self._folder / f"{job_id}{'-' if job_id else ''}{secrets.token_hex(16)}{suffix}"

    def check_drafts(self) -> None:
        """Raise `OSError` when no draft can be written. What is tried with has no name, where the disk can do that."""
        with tempfile.TemporaryFile(dir=self._folder) as file:
            file.write(b"ok")

    def new_draft(self) -> tuple[Path, IO[bytes]]:
        """A draft without a job, opened for writing. It is kept for as long as it is open; see `clear_drafts`."""
        path = self.draft()
        file = path.open("xb")
        fcntl.flock(file, fcntl.LOCK_EX)
        return path, file

    def new_folder(self) -> tuple[Path, int]:
        """A folder for drafts of no job, and a descriptor: it is kept for as long as that is open."""
        path = self.draft()
        path.mkdir()
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        return path, descriptor

    def clear_drafts(self, *, held: Callable[[Collection[str]], Collection[str]], before: datetime) -> int:
        """Remove the temporary files whose writer is gone. Returns their number.

        They may hold a face, so they must not outlive what they were made from. A job is claimed before its first draft
        is made, and its last one is published or removed before it ends: a draft whose job is not among those that
        ``held`` returns, of the ids it is given, was left by a process that was killed. Any other draft was made by
        `new_draft`, or `new_folder`, and is removed when nobody has it open and it was last touched before ``before``.
        """
        by_job: dict[str, list[Path]] = {}
        old: list[Path] = []
        for path in self._folder.iterdir():
            # a file that was named after a draft carries its job's id too
            if owner := JOB_ID.search(path.name):
                by_job.setdefault(owner[0], []).append(path)
                continue
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < before.timestamp() and not _is_open(path):
                    old.append(path)
        kept = held(by_job.keys()) if by_job else ()
        gone = [path for job_id, paths in by_job.items() if job_id not in kept for path in paths]
        removed = 0
        for path in (*gone, *old):
            with suppress(FileNotFoundError):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)  # one whose job was taken away may still write into it
                else:
                    path.unlink()
                removed += 1
        return removed


def _is_open(path: Path) -> bool:
    """Some process has the draft open that `new_draft` or `new_folder` made, under this name or another."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # where locks are not to be had, nothing is known
        return True
    finally:
        os.close(descriptor)
    return False
