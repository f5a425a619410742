"""Everything that a revoked key has is erased: its records, then the bytes that no record names any more.

Nothing of a revoked key is recorded anew (`service.api.quotas.lock_key`), so what is erased here is all there is, also
beside a running service. What ends the process in between does no harm: what is left is found by the next try, and
blobs whose records are gone are known by their tombstones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from sqlalchemy.orm import Session

from service.blobs import Blobs, was_marked
from service.catalog import Database, Message, belongings, tombstones
from service.catalog.belongings import Belongings
from service.queue import Publisher
from service.room import Room
from service.settings import Settings
from service.storage import Storage


class Erasure:
    """Erases what owners have."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._database = database
        self._storage = Storage(settings, was_marked=partial(was_marked, database))
        self._blobs = Blobs(database, self._storage)
        self._publisher = Publisher(settings, database)  # it takes messages back, and is not started

    def count(self, owner: str) -> Belongings:
        """What an owner has now."""
        with self._database.read() as session:
            return belongings.count(session, owner)

    def erase_records(self, owner: str) -> None:
        """Remove all records of what an owner has; receivers of its webhooks are told nothing any more."""
        self._each(
            lambda session: belongings.told_jobs(session, owner),
            lambda session, job_id: belongings.remove_deliveries(session, owner, job_id),
        )
        self._each(
            lambda session: belongings.media_ids(session, owner),
            lambda session, media_id: belongings.remove_medium(session, owner, media_id, now=self._database.now()),
        )
        self._each(
            lambda session: belongings.upload_ids(session, owner),
            lambda session, upload_id: belongings.remove_upload(session, upload_id, now=self._database.now()),
        )
        self._each(
            lambda session: belongings.job_ids(session, owner),
            lambda session, job_id: belongings.remove_job(session, owner, job_id, now=self._database.now()),
        )
        with self._database.write(frees=True) as session:
            belongings.remove_rest(session, owner, now=self._database.now())

    def _each(
        self,
        some: Callable[[Session], list[str]],
        remove: Callable[[Session, str], list[Message] | None],
    ) -> None:
        """Remove what there is ``some`` of, until there is none, each in a transaction of its own."""
        while ids := self._read(some):
            for one in ids:
                with self._database.write(frees=True) as session:
                    messages = remove(session, one)
                self._publisher.withdraw(messages or ())

    def _read(self, some: Callable[[Session], list[str]]) -> list[str]:
        with self._database.read() as session:
            return some(session)

    def delete_files(self) -> tuple[int, int]:
        """Delete the blobs that no record names any more, whosoever they were.

        Returns the numbers of those that are gone, and of those that are still there: the storage does not delete them
        now. Raises the storage's error when that is away.
        """
        gone = sum(iter(self._blobs.sweep, 0))
        self._database.forget(wholly=True)
        with self._database.read() as session:
            awaited = tombstones.awaited(session, now=self._database.now())
        return gone, sum(self._storage.exists(key) for key in awaited)


@contextmanager
def open_erasure(settings: Settings) -> Iterator[Erasure]:
    """What erases, for the time of the block."""
    database = Database(settings.database, before_freeing=Room(settings).give_back)
    try:
        yield Erasure(settings, database)
    finally:
        database.close()
