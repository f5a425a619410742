"""The collector: finds files in the store that no record names, and has them deleted.

A record, or a tombstone, names a file from before its first byte (docs/decisions/0021): what has none was left by a
former version or a backup. Or the records are not those of the files, and then all is lost that is removed; see
docs/decisions/0049 for what is asked of a store before anything is.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from itertools import islice
from typing import Final

import structlog

from service.catalog import Database, collecting, sweep, tombstones
from service.catalog.collecting import Mark
from service.outages import is_outage
from service.rounds import Rounds
from service.settings import Settings
from service.storage import Storage, is_key

log = structlog.get_logger(__name__)

#: how often it is looked whether a search is due
_LOOK_S: Final = 60.0
#: so many files may go though they are most of what is there
_HANDFUL: Final = 20

_END_OF_TIME: Final = datetime.max.replace(tzinfo=UTC)

_ADOPT: Final = "`pvg-service adopt` makes the files this database's"


class HaltedError(Exception):
    """Nothing was removed, since the files may be those of other records. Says why and what to do."""

    def __init__(self, why: str, detail: str) -> None:
        super().__init__(f"files without a record are kept: {detail}")
        self.why = why


class _StoppedError(Exception):
    """The process ends."""


class Collector:
    """Searches the store in a thread of its own, now and then; of several processes one does.

    A search reads the whole store, a page at a time, and buries what it finds: the reaper deletes it.
    """

    def __init__(self, settings: Settings, database: Database, storage: Storage) -> None:
        self._database = database
        self._storage = storage
        self._interval = timedelta(seconds=settings.collect_interval_s)
        self._ttl = timedelta(seconds=settings.orphan_ttl_s)
        self._rounds = Rounds("collector", self._round, min(_LOOK_S, settings.collect_interval_s))

    def start(self) -> None:
        """Start to look whether a search is due; the first time at once."""
        self._rounds.start()

    def stop(self) -> None:
        """Stop after the present page."""
        self._rounds.stop()

    def _round(self) -> None:
        try:
            self._storage.clear_incoming(before=self._database.now() - self._ttl)
            self.collect_when_due()
        except _StoppedError:
            pass
        except HaltedError as error:
            log.error(str(error))
        except Exception as error:
            if is_outage(error):
                log.warning("the database or the storage is away", step="collect", error=type(error).__name__)
            else:
                log.exception("a search for files without a record failed")

    def collect_when_due(self) -> None:
        """`collect`, unless it was begun less than ``collect_interval_s`` ago, here or by another process."""
        now = self._database.now()
        with self._database.write() as session:
            is_due = collecting.begin(session, now=now, unless_since=now - self._interval)
        if is_due and (found := self.collect()):
            log.info("files without a record are removed", count=found)

    def collect(self, *, even_most: bool = False) -> int:
        """Have the files deleted that no record names and that are older than ``orphan_ttl_s``. Returns their number.

        Raises `HaltedError` when the store is not this database's, or this database is older than its files; and when
        more than half of the files would go, unless ``even_most``.
        """
        try:
            before = self._database.now() - self._ttl
            self._storage.check_mounted()
            self._check_mark()
            found = self._check_share(before, even_most=even_most)
        except HaltedError as error:
            with self._database.write(frees=True) as session:
                collecting.halt(session, error.why)
            raise
        self._set_mark()
        self._storage.clear_former_pieces(before=before)
        return self._bury(before) if found else 0

    def adopt(self) -> tuple[int, int]:
        """Make the store this database's. Returns how many files it has, and how many of them have no record."""
        found = self._storage.mark()
        self._set_mark(after=0 if found is None else Mark.read(found).number)
        return self._count(_END_OF_TIME)

    def _check_mark(self) -> None:
        text = self._storage.mark()
        # read after the store's: it never carries a number that was not written here before
        with self._database.write(frees=True) as session:
            own = collecting.mark(session)
        if text is None:
            there, unknown = self._count(_END_OF_TIME)
            if unknown * 2 > there:
                raise HaltedError(
                    "unknown-files",
                    f"{unknown} of the {there} in the store are not this database's, and the store does not say whose "
                    f"it is. Look at PVG_DATABASE_URL and PVG_STORAGE_URL; if they are right, {_ADOPT}",
                )
            self._storage.set_mark(str(own))  # before a search is counted: from then on a store without a mark is away
            return
        found = Mark.read(text)
        if found.database_id != own.database_id:
            raise HaltedError(
                "another-database",
                "the store is another database's. Look at PVG_DATABASE_URL and PVG_STORAGE_URL; if they are right, "
                f"{_ADOPT}",
            )
        if found.number > own.number:
            raise HaltedError(
                "older-database",
                "this database is older than the files, as after a backup was restored. If it is the one to stay, "
                f"{_ADOPT}",
            )

    def _check_share(self, before: datetime, *, even_most: bool) -> int:
        there, unknown = self._count(before)
        if unknown > _HANDFUL and unknown * 2 > there and not even_most:
            raise HaltedError(
                "most-files",
                f"they are {unknown} of {there}. Look whether this is the right database, and no older than the "
                "files; if they are to go, `pvg-service gc --even-most` removes them",
            )
        return unknown

    def _set_mark(self, *, after: int = 0) -> None:
        with self._database.write(frees=True) as session:
            mark = collecting.next_mark(session, after=after)
        self._storage.set_mark(str(mark))

    def _count(self, before: datetime) -> tuple[int, int]:
        """How many files there are, and how many of those from before ``before`` have no record."""
        there = unknown = 0
        for keys, orphans in self._pages(before):
            there += keys
            unknown += len(orphans)
        return there, unknown

    def _bury(self, before: datetime) -> int:
        buried = 0
        for _, orphans in self._pages(before):
            if orphans:
                with self._database.write(frees=True) as session:
                    # somebody may have begun to write one again
                    still = set(orphans) - sweep.known_keys(session, orphans)
                    tombstones.bury(session, still, now=self._database.now())
                buried += len(still)
        return buried

    def _pages(self, before: datetime) -> Iterator[tuple[int, list[str]]]:
        """Of the files of the store, some at a time: their number, and which of before ``before`` have no record.

        What is not of this service's own form is not looked at.
        """
        entries = ((key, written) for key, written in self._storage.entries() if is_key(key))
        while page := list(islice(entries, sweep.BATCH)):
            if self._rounds.is_stopping:
                raise _StoppedError
            old = [key for key, written in page if written < before]
            with self._database.read() as session:
                known = sweep.known_keys(session, old)
            yield len(page), [key for key in old if key not in known]
