"""Copies of blobs of an object store, which all clips share that are opened with them.

A blob is fetched by a thread of its own: who waits for it may give up before it is there, and the next one finds it.
"""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from service.room import Room
from service.settings import Settings
from service.storage import Storage
from worker.sandbox import TimeLimitError

#: blobs that are fetched at once; a picture needs three
_AT_ONCE: Final = 6
#: copies that are kept; each takes a descriptor
_MOST: Final = 100


@dataclass(frozen=True)
class Blob:
    """A blob, and the medium that it belongs to, by its id and its asset at the time."""

    key: str
    medium_id: str
    asset_key: str | None


@dataclass(eq=False)
class _Copy:
    blob: Blob
    #: where it is, once it is there
    fetched: Future[Path] = field(init=False)
    held: ExitStack = field(default_factory=ExitStack)
    size_bytes: int = 0
    users: int = 0
    used_at: float = 0.0
    is_dropped: bool = False

    def check(self) -> None:
        """Raise `CancelledError` when nobody wants it any more."""
        if self.is_dropped:
            raise CancelledError


class Copies:
    """The copies that are there or on their way. Any thread may ask.

    One that nobody uses is dropped after `Settings.preview_copy_idle_s`, before that when there are too many or the
    disk is short, and at once when its medium is deleted or vectorised anew: whoever has this looks for it often.
    """

    def __init__(self, settings: Settings, storage: Storage) -> None:
        self._settings = settings
        self._storage = storage
        self._room = Room(settings)
        self._copies: dict[str, _Copy] = {}
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="copies")

    @contextmanager
    def held(self, blobs: Sequence[Blob], until: float) -> Iterator[list[Path]]:
        """The files of these blobs, kept for the time of the block. They must not be changed.

        Raises `TimeLimitError` when one is not there by ``until``, on the clock of `time.monotonic`, and goes on to be
        fetched then; and what `Storage.local_path` raises.
        """
        copies: list[_Copy] = []
        try:
            copies.extend(self._take(blob) for blob in blobs)
            yield [_path(copy, until) for copy in copies]
        finally:
            with self._lock:
                for copy in copies:
                    self._give(copy)

    @property
    def media_ids(self) -> set[str]:
        """The media that there are copies of."""
        with self._lock:
            return {copy.blob.medium_id for copy in self._copies.values()}

    def drop_old(self) -> None:
        """Drop those that nobody has used for long, and more of them where they are too many."""
        settings, now = self._settings, time.monotonic()
        is_short = bool(self._copies) and self._room.is_short()
        with self._lock:
            size, count = sum(copy.size_bytes for copy in self._copies.values()), len(self._copies)
            for copy in sorted(self._unused(), key=lambda copy: copy.used_at):
                is_over = is_short or size > settings.preview_copy_bytes or count > _MOST
                # who has waited for it in vain asks again before long
                kept_s = settings.preview_timeout_s if is_over else settings.preview_copy_idle_s
                if copy.used_at < now - kept_s:
                    self._drop(copy)
                    size, count = size - copy.size_bytes, count - 1

    def drop_deleted(self, present: Mapping[str, str | None]) -> None:
        """Drop those of media that are not there any more, or have another asset; ``present`` has the assets of all."""
        with self._lock:
            for copy in self._unused():
                if present.get(copy.blob.medium_id, "") != copy.blob.asset_key:
                    self._drop(copy)

    def close(self) -> None:
        """Drop all, for good."""
        with self._lock:
            for copy in list(self._copies.values()):
                self._drop(copy)
        self._threads.shutdown(wait=False)

    def _take(self, blob: Blob) -> _Copy:
        with self._lock:
            copy = self._copies.get(blob.key)
            if copy is None:
                copy = self._copies[blob.key] = _Copy(blob)
                copy.fetched = self._threads.submit(self._fetch, copy)
            copy.blob = blob
            copy.users += 1
            return copy

    def _give(self, copy: _Copy) -> None:
        copy.users -= 1
        copy.used_at = time.monotonic()
        if not copy.users and copy.fetched.cancel():  # it was not begun
            self._forget(copy)

    def _fetch(self, copy: _Copy) -> Path:
        try:
            folder, descriptor = self._storage.spool.new_folder()
            copy.held.callback(shutil.rmtree, folder, ignore_errors=True)
            copy.held.callback(os.close, descriptor)
            local = self._storage.local_path(copy.blob.key, folder=folder, check=copy.check)
            path = copy.held.enter_context(local).resolve()
            copy.size_bytes = path.stat().st_size
        except BaseException:  # the next one tries again
            copy.held.close()
            with self._lock:
                self._forget(copy)
            raise
        copy.used_at = time.monotonic()
        return path

    def _unused(self) -> list[_Copy]:
        return [copy for copy in self._copies.values() if not copy.users]

    def _drop(self, copy: _Copy) -> None:
        """Forget a copy, and have it removed at once, or as soon as its thread has noticed."""
        self._forget(copy)
        copy.is_dropped = True
        copy.fetched.cancel()
        copy.fetched.add_done_callback(lambda _: copy.held.close())

    def _forget(self, copy: _Copy) -> None:
        if self._copies.get(copy.blob.key) is copy:
            del self._copies[copy.blob.key]


def _path(copy: _Copy, until: float) -> Path:
    if not wait([copy.fetched], timeout=max(0.0, until - time.monotonic())).done:
        raise TimeLimitError("a file of the clip has not come from the store in time")
    return copy.fetched.result()
