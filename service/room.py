"""Room on the disk: what is refused while there is little, and the reserve that deletions have when there is none."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final

import structlog

from service.errors import StorageFullError
from service.settings import Settings

log = structlog.get_logger(__name__)

#: the reserve file, and the parts in which it is given back: more than SQLite's log of a few hundred deletions each,
#: and several, as whoever fills the disk may take each of them
_RESERVE_FILE_BYTES: Final = 16 * 1024**2
_PARTS: Final = 4
#: seconds between two looks at the disks while they are watched
_LOOK_S: Final = 1.0


class Room:
    """The free space of the disks that this machine's folders are on.

    Below ``min_free_bytes`` of the settings nothing is begun that would need more: uploads, new jobs, work on jobs.
    What others write may still fill the disk. SQLite then could not even delete, as that is written to its log first;
    so a file of some size is kept, and given back when something is to be deleted, or a job canceled, on a full disk.

    A shared folder that hangs holds whoever asks it, and an event loop must not be held: between `watch` and `unwatch`
    the answers are those of the last look of a thread, less what was written since, and no caller waits for a disk.
    """

    def __init__(self, settings: Settings) -> None:
        folders = (settings.folder, settings.spool_folder, settings.local_storage_folder)
        self._folders = tuple(folder for folder in folders if folder is not None)
        self._min_free_bytes = settings.min_free_bytes
        self._reserve = settings.folder / "reserve"
        self._reserve_bytes = min(_RESERVE_FILE_BYTES, settings.min_free_bytes // 2)
        #: all that this process has said to write
        self._written = 0
        #: what was free at the last look, and what had been written by its beginning
        self._seen: tuple[int, int] | None = None
        #: the log says that there is too little
        self._said_short = False
        self._stop = threading.Event()

    def watch(self) -> None:
        """Begin to look at the disks now and then, in a thread."""
        self._look()
        threading.Thread(target=self._run, name="room", daemon=True).start()

    def unwatch(self) -> None:
        """Look no more; the thread ends by itself, for it may hang."""
        self._stop.set()

    def _run(self) -> None:
        while not self._stop.wait(_LOOK_S):
            with suppress(OSError):  # what was seen last holds; who uses the folder is told
                self._look()

    def _look(self) -> None:
        written = self._written
        self._seen = (self._free(), written)
        self._say()

    def _say(self) -> None:
        """Log that there is too little room, and that there is some again, once each."""
        if (is_short := self.is_short()) == self._said_short:
            return
        self._said_short = is_short
        about = {"free_bytes": self.free_bytes(), "min_free_bytes": self._min_free_bytes}
        if is_short:
            log.warning("too little room on the disk: uploads and new jobs are refused", **about)
        else:
            log.info("there is room on the disk again", **about)

    def _free(self) -> int:
        return min(_free(folder) for folder in self._folders)

    def free_bytes(self) -> int:
        """What this process may still write, on the disk that has least."""
        if self._seen is None:
            return self._free()
        free, written = self._seen
        return max(0, free - (self._written - written))

    def take(self, size_bytes: int) -> None:
        """So many bytes are about to be written: the next look may come later. Called by an event loop alone.

        Raises `StorageFullError` when there is too little room.
        """
        self.require(size_bytes)
        self._written += size_bytes

    def is_short(self, more_bytes: int = 0) -> bool:
        """Too little is free, or would be after so many more bytes."""
        return self.free_bytes() - more_bytes < self._min_free_bytes

    def require(self, more_bytes: int = 0) -> None:
        """Raise `StorageFullError` when there is too little room for something new of this size."""
        if self.is_short(more_bytes):
            raise StorageFullError()

    def keep_reserve(self) -> None:
        """Make the reserve file where it is missing, or what is missing of it, and there is room for that."""
        least = self._reserve_bytes + self._min_free_bytes
        if self._reserve_left() == self._reserve_bytes or _free(self._reserve.parent) < least:
            return
        with self._reserve.open("ab") as file:
            os.posix_fallocate(file.fileno(), 0, self._reserve_bytes)

    def give_back(self) -> None:
        """Give a part of the reserve back when less than half of that is free: something is to be deleted."""
        part = self._reserve_bytes // _PARTS
        # one part is for many: they do not take another each, as soon as the first has written a page
        if _free(self._reserve.parent) >= part // 2 or not (left := self._reserve_left()):
            return
        with suppress(FileNotFoundError):
            os.truncate(self._reserve, max(0, left - part))
        log.warning("the disk is full; a part of the reserve is given back for what deletes", left=max(0, left - part))

    def _reserve_left(self) -> int:
        try:
            return self._reserve.stat().st_size
        except FileNotFoundError:
            return 0


def _free(folder: Path) -> int:
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize
