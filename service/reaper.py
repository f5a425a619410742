"""The reaper: queues jobs again whose worker or message was lost, and removes what is past its retention."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable
from datetime import timedelta

import structlog

from service.catalog import Database, Message, jobs, sweep
from service.queue import QUEUES, Publisher
from service.settings import Settings
from service.storage import Storage

log = structlog.get_logger(__name__)


class Reaper:
    """Runs its rounds in a thread. Several reapers at once do no harm: each step is a conditional update."""

    def __init__(self, settings: Settings, database: Database, storage: Storage, publisher: Publisher) -> None:
        self._settings = settings
        self._database = database
        self._storage = storage
        self._publisher = publisher
        self._short: set[str] = set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="reaper", daemon=True)

    def start(self) -> None:
        """Start the rounds; the first one runs at once."""
        self._thread.start()

    def stop(self) -> None:
        """Stop after the present round."""
        self._stop.set()
        self._thread.join(timeout=5)

    def _run(self) -> None:
        while True:
            self.round()
            if self._stop.wait(self._settings.reap_interval_s):
                return

    def round(self) -> None:
        """One round. A step that fails is logged and does not keep the others from running."""
        steps: tuple[Callable[[], object], ...] = (self.revive, self.republish, self.expire)
        for step in steps:
            try:
                step()
            except Exception:
                log.exception("a step of the reaper failed", step=step.__name__)

    def revive(self) -> list[Message]:
        """Queue lapsed jobs again, end those out of attempts or time, release waiting jobs."""
        now = self._database.now()
        with self._database.write() as session:
            again = jobs.reap(session, now=now, max_attempts=self._settings.max_attempts)
            queued_since = now - timedelta(seconds=self._settings.max_queued_s)
            jobs.expire(session, before=queued_since, now=now)
            again += jobs.release(session, now=now)
        for message in again:
            log.info("job queued again", job=message.job_id, queue=message.queue)
        self._publisher.publish(again)
        return again

    def republish(self) -> list[Message]:
        """Send messages again that never reached the broker or that it lost.

        A queue that holds fewer messages than there are queued jobs in two rounds in a row has lost some; once may be a
        message on its way to a worker. Which ones are lost is not known, so all are sent again. A message too many is
        harmless: its job cannot be claimed twice.
        """
        before = self._database.now() - timedelta(seconds=self._settings.republish_after_s)
        with self._database.read() as session:
            missing = sweep.unpublished(session, before=before)
            expected = {name: sweep.queued_count(session, name) for name in QUEUES}
        for name, count in expected.items():
            short = count > 0 and self._is_short(name, count)
            again = short and name in self._short
            (self._short.add if short and not again else self._short.discard)(name)
            if again:
                with self._database.read() as session:
                    missing += sweep.published(session, name, before=before)
        if missing:
            log.info("publishing again", count=len(missing))
        self._publisher.publish(missing)
        return missing

    def _is_short(self, name: str, expected: int) -> bool:
        try:
            return self._publisher.depth(name) < expected
        except Exception as error:
            log.warning("broker does not answer", queue=name, error=type(error).__name__)
            return False

    def expire(self) -> None:
        """Remove results, media and job records past their retention, and drafts whose writer is gone."""
        now = self._database.now()
        with self._database.write() as session:
            keys = sweep.expire_results(session, now=now)
            keys += sweep.expire_media(session, now=now)
            sweep.expire_jobs(session, before=now - timedelta(seconds=self._settings.job_ttl_s))
        self._delete(keys)
        self._storage.clear_drafts(held=self._held, before=now - timedelta(seconds=self._settings.draft_ttl_s))

    def _held(self, job_ids: Collection[str]) -> set[str]:
        with self._database.read() as session:
            return sweep.held(session, job_ids)

    def collect(self) -> int:
        """Delete blobs that no record names, left by a process that ended between two steps. Returns their number."""
        before = self._database.now() - timedelta(seconds=self._settings.orphan_ttl_s)
        old = [key for key, written in self._storage.entries() if written < before]
        orphans: list[str] = []
        for start in range(0, len(old), sweep.BATCH):
            batch = old[start : start + sweep.BATCH]
            with self._database.read() as session:
                known = sweep.known_keys(session, batch)
            orphans += [key for key in batch if key not in known]
        self._delete(orphans)
        return len(orphans)

    def _delete(self, keys: Iterable[str]) -> None:
        for key in keys:
            self._storage.delete(key)
