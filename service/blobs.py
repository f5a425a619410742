"""Blobs and their records kept in step: none is written without being known, and none is forgotten before it is gone.

See `service.catalog.tombstones` for how. The bytes are in `service.storage`.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

import structlog

from service.catalog import Database, Lease, collecting, tombstones
from service.outages import is_disk_full, is_outage
from service.storage import Storage

log = structlog.get_logger(__name__)

#: seconds in which a blob is recorded from when it was last seen to be written, when nobody says otherwise
WRITE_S: Final = 900.0
#: seconds for which a request, or a round of the reaper, waits for a store to delete; later rounds see to the rest
PATIENCE_S: Final = 5.0
#: how many are looked for in a round, and how many are taken at a time: those that it does not come to stay due
_BATCH: Final = 200
_AT_ONCE: Final = 10
#: threads that delete for those who ask; while a store hangs they stay
_THREADS: Final = 16


def was_marked(database: Database) -> bool:
    """The store has carried the mark of this database, and is away when it carries none; see `Storage`."""
    with database.read() as session:
        return collecting.was_marked(session)


class Blobs:
    """Writes and deletes blobs, each step known to the catalog before it is taken."""

    def __init__(self, database: Database, storage: Storage, *, within_s: float = WRITE_S) -> None:
        self._database = database
        self._storage = storage
        self._within_s = within_s
        self._sweeping: threading.Thread | None = None
        self._deleting = threading.Semaphore(_THREADS)

    def put(
        self, path: Path, key: str, *, lease: Lease | None = None, check: Callable[[], None] = lambda: None
    ) -> None:
        """Store a finished file under its key. The file at ``path`` goes away. ``check`` may end it; see `Storage.put`.

        Whoever records the blob says so with `tombstones.recorded` in the same transaction; else it is deleted again,
        and at once when the ``lease`` under which it is written is lost.
        """
        self.expect(key, lease=lease)
        self.send(path, key, check=check)

    def expect(self, key: str, *, lease: Lease | None = None) -> None:
        """The first half of `put`, for those who store the bytes by themselves: a blob of this key is about to come."""
        with self._database.write() as session:
            now = self._database.now()
            tombstones.expect(session, key, now=now, within_s=self._within_s, lease=lease)

    def send(self, path: Path, key: str, *, check: Callable[[], None] = lambda: None) -> None:
        """The second half: store the file, and expect it for as long as that goes on."""
        held_at = time.monotonic()

        def go_on() -> None:
            nonlocal held_at
            check()
            if time.monotonic() - held_at > self._within_s / 3:
                held_at = time.monotonic()
                self._hold(key)

        self._storage.put(path, key, check=go_on)

    def _hold(self, key: str) -> None:
        try:
            with self._database.write() as session:
                tombstones.hold(session, key, now=self._database.now(), within_s=self._within_s)
        except Exception as error:  # it is tried again before it is due
            log.warning("a blob that is being written could not be held", error=type(error).__name__)

    def discard(self, keys: Collection[str]) -> None:
        """Delete blobs that were put and will not be recorded. Never fails: their tombstones are there already."""
        try:
            self.bury(keys)
        except Exception as error:
            log.warning("blobs are deleted later", count=len(keys), error=type(error).__name__)
        else:
            self.delete(keys)

    def bury(self, keys: Collection[str]) -> None:
        """The first half of `discard`: they are due from now on. Where it fails, they are due later."""
        with self._database.write(frees=True) as session:
            tombstones.bury(session, keys, now=self._database.now())

    def delete(self, keys: Collection[str]) -> None:
        """Delete blobs whose tombstones are written, now if the store answers in time, else later.

        Never fails and waits `PATIENCE_S` at most: what is left is found by `sweep`. While a store hangs on what
        earlier calls asked of it, nothing more is asked.
        """
        if not keys:
            return
        if not self._deleting.acquire(blocking=False):
            log.warning("the store takes its time to delete; more is deleted later", count=len(keys))
            return
        thread = threading.Thread(target=self._delete_beside, args=(keys,), name="delete-blobs", daemon=True)
        thread.start()
        thread.join(PATIENCE_S)
        if thread.is_alive():
            log.warning("the store takes its time to delete; going on without waiting", count=len(keys))

    def sweep(self) -> int:
        """Delete the blobs that are due. Returns the number of those that are gone now.

        Begins none after `PATIENCE_S`, and waits for no longer than that once more: leases and messages are seen to by
        the same thread. While a store hangs on what an earlier call asked of it, nothing more is asked.
        """
        if self._sweeping is not None and self._sweeping.is_alive():
            return 0
        with self._database.read() as session:
            keys = tombstones.due(session, now=self._database.now(), limit=_BATCH)
        if not keys:
            return 0
        gone: list[int] = []
        until = time.monotonic() + PATIENCE_S
        self._sweeping = threading.Thread(
            target=lambda: gone.append(self._delete(keys, until=until)), name="sweep-blobs", daemon=True
        )
        self._sweeping.start()
        self._sweeping.join(2 * PATIENCE_S)
        if self._sweeping.is_alive():
            log.warning("the store hangs; what is left is deleted later", count=len(keys))
        return sum(gone)

    def _delete_beside(self, keys: Collection[str]) -> None:
        try:
            self._delete(keys)
        finally:
            self._deleting.release()

    def _delete(self, keys: Collection[str], *, until: float = math.inf) -> int:
        """Delete these, a few at a time, until the store is away or it is ``until``. Returns how many are gone."""
        left, count, goes_on = list(keys), 0, True
        try:
            while left and goes_on and time.monotonic() < until:
                batch, left = left[:_AT_ONCE], left[_AT_ONCE:]
                with self._database.write(frees=True) as session:
                    taken = tombstones.take(session, batch, now=self._database.now())
                done, goes_on = self._delete_taken(taken, until)
                with self._database.write(frees=True) as session:
                    tombstones.gone(session, done, now=self._database.now())
                count += len(done)
        except Exception as error:  # the tombstones stay
            say = log.warning if is_outage(error) or is_disk_full(error) else log.exception
            say("blobs are deleted later", count=len(keys) - count, error=type(error).__name__)
        return count

    def _delete_taken(self, keys: Collection[str], until: float) -> tuple[list[str], bool]:
        """Those that are gone, and whether it is worth while to go on."""
        done: list[str] = []
        for key in keys:
            if time.monotonic() >= until:
                return done, False
            try:
                self._storage.delete(key)
            except Exception as error:
                log.warning("a blob could not be deleted, trying again later", error=type(error).__name__)
                if is_outage(error):
                    return done, False
            else:
                done.append(key)
        return done, True
