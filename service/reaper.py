"""The reaper: queues jobs again whose worker or message was lost, and removes what is past its retention."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from datetime import datetime, timedelta

import structlog
from sqlalchemy.exc import DBAPIError

from service.blobs import WRITE_S, Blobs
from service.catalog import Database, Lease, Message, idempotency, jobs, leases, previews, set_back, sweep, webhooks
from service.drafts import Drafts
from service.outages import is_disk_full, is_outage, is_partly_locked, told
from service.queue import QUEUES, Publisher, clear_remains
from service.room import Room
from service.rounds import Rounds
from service.settings import Settings
from service.storage import Storage

log = structlog.get_logger(__name__)


class Reaper:
    """Runs its rounds in a thread. Several reapers at once do no harm: each step is a conditional update."""

    def __init__(
        self,
        settings: Settings,
        database: Database,
        storage: Storage,
        room: Room,
        blobs: Blobs,
        publisher: Publisher,
    ) -> None:
        self._settings = settings
        self._database = database
        self._drafts = Drafts(database, storage.spool, settings)
        self._room = room
        self._blobs = blobs
        self._publisher = publisher
        self._spared_until = -math.inf
        #: the database's time and this machine's steady one, when a round last asked
        self._asked: tuple[datetime, float] | None = None
        self._rested_at = math.inf
        self._is_set_back = False
        self._short: set[Message] = set()
        #: steps that had no room in the last round
        self._full: list[str] = []
        self._whole_at = time.monotonic()
        self._rounds = Rounds("reaper", self.round, settings.reap_interval_s)

    def start(self) -> None:
        """Start the rounds; the first one runs at once, and leaves workers alone as after an outage."""
        self._spare_leases()
        self._rounds.start()

    def stop(self) -> None:
        """Stop after the present round."""
        self._rounds.stop()

    def round(self) -> None:
        """One round. A step that fails is logged and does not keep the others from running."""
        steps: tuple[Callable[[], object], ...] = (
            self.revive,
            self.release,
            self.republish,
            self.expire,
            self.delete,
            self._room.keep_reserve,
        )
        is_whole = True
        full: list[str] = []
        for step in steps:
            began = time.monotonic()
            try:
                step()
            except Exception as error:
                is_whole = False
                if self._failed(step, error, began):
                    full.append(step.__name__)
        self._say_full(full)
        self._rested_at = time.monotonic()
        if is_whole:
            self._whole_at = self._rested_at

    def _failed(self, step: Callable[[], object], error: Exception, began: float) -> bool:
        """Log why a step failed, and spare leases that could not be renewed meanwhile. Whether the disk is full."""
        is_revival = step == self.revive
        if is_disk_full(error):
            if is_revival and isinstance(error, DBAPIError):  # workers cannot renew theirs either
                self._spare_leases()
            return True  # all such steps are told in one line, see `_say_full`
        if is_partly_locked(error) and not is_revival:  # workers renew their leases all the same
            log.warning("others keep what the reaper waits for", step=step.__name__)
        elif is_outage(error):
            if is_revival or not self._answered_since(began):
                self._spare_leases()
            log.warning("the database or the storage is away", step=step.__name__, error=type(error).__name__)
        else:
            log.exception("a step of the reaper failed", step=step.__name__)
        return False

    def _say_full(self, steps: list[str]) -> None:
        """Log which steps had no room on the disk, once for as long as they are the same."""
        before, self._full = self._full, steps
        if steps and steps != before:
            log.warning("the disk is full: steps of the reaper wait for room", steps=steps)

    @property
    def idle_s(self) -> float:
        """Seconds since the last round that did all of its steps, or since the start."""
        return time.monotonic() - self._whole_at

    def _spare_leases(self) -> None:
        """Take no lease for over before its worker had time to renew it: while the database was away, it could not."""
        # it was away until the next round at most, and a worker renews within a heartbeat
        self._spared_until = time.monotonic() + self._settings.reap_interval_s + 2 * self._settings.heartbeat_s

    def _answered_since(self, began: float) -> bool:
        """The database answers, and was away since then for less than a heartbeat: that is too short to do harm."""
        try:
            with self._database.write() as session:  # as those who renew theirs do
                leases.renew(session, Lease("", ""), now=self._database.now(), lease_s=0)
        except Exception:
            return False
        return time.monotonic() - began < self._settings.heartbeat_s

    def _time(self) -> datetime:
        """The database's time. Leases are spared when a clock was set, or when this process was held up.

        A machine that sleeps, and containers that are paused, hold up workers too: their leases run out meanwhile. What
        is shorter than a heartbeat does no harm. A round itself may be long.
        """
        now, steady = self._database.now(), time.monotonic()
        late_s = max(0.0, steady - self._rested_at - self._settings.reap_interval_s)
        ahead_s = 0.0
        if self._asked is not None:
            ahead_s = (now - self._asked[0]).total_seconds() - (steady - self._asked[1])
        self._asked = now, steady
        if max(late_s, abs(ahead_s)) > self._settings.heartbeat_s:
            log.warning("workers have time to renew their leases", late_s=round(late_s), ahead_s=round(ahead_s))
            self._spare_leases()
            self._is_set_back |= ahead_s < -self._settings.heartbeat_s
        return now

    def revive(self) -> list[Message]:
        """Queue lapsed jobs again, end those out of attempts."""
        now = self._time()
        spared = time.monotonic() < self._spared_until
        with self._database.write() as session:
            if self._is_set_back:
                lease_s, write_s = self._settings.lease_s, max(WRITE_S, self._settings.job_hard_limit_s)
                set_back.mend(session, now=now, lease_s=lease_s, write_s=write_s)
            again = [] if spared else leases.reap(session, now=now, max_attempts=self._settings.max_attempts)
            leases.rewrite_one(session)
        self._is_set_back = False
        for message in again:
            log.info("job queued again", job=message.job_id, queue=message.queue)
        self._publisher.publish(again)
        return again

    def release(self) -> list[Message]:
        """End queued jobs out of time, release those whose media are ready, and webhooks whose jobs have ended."""
        now = self._database.now()
        with self._database.write() as session:
            queued_since = now - timedelta(seconds=self._settings.max_queued_s)
            jobs.expire(session, before=queued_since, now=now)
            released = jobs.release(session, now=now)
            webhooks.wake(session, now=now)
        for message in released:
            log.info("job released", job=message.job_id, queue=message.queue)
        self._publisher.publish(released)
        return released

    def republish(self) -> list[Message]:
        """Send messages again that never reached the broker or that it lost.

        A message is lost that is missing in two rounds in a row; once may be one on its way to a worker. Of a broker
        that only counts its messages it is not known which ones are lost, so all are sent again. A message too many is
        harmless: its job cannot be claimed twice.
        """
        before = self._database.now() - timedelta(seconds=self._settings.republish_after_s)
        with self._database.read() as session:
            missing = sweep.unpublished(session, before=before)
        absent = {message for name in QUEUES for message in self._absent(name, before)}
        missing += sorted(absent & self._short, key=lambda message: message.job_id)
        self._short = absent.difference(missing)
        if missing:
            log.info("publishing again", count=len(missing))
        self._publisher.publish(missing)
        return missing

    def _absent(self, name: str, before: datetime) -> list[Message]:
        """The jobs that should have a message in this queue, and that have none, or may have none."""
        try:
            # the broker first: a job that a worker takes meanwhile is not queued any more
            held = self._publisher.sent(name)
            depth = self._publisher.depth(name) if held is None else 0
        except Exception as error:
            log.warning("broker does not answer", queue=name, **told(error))
            return []
        with self._database.read() as session:
            expected = sweep.published(session, name, before=before)
        if held is None:
            return expected if depth < len(expected) else []
        return [message for message in expected if message.job_id not in held]

    def expire(self) -> int:
        """Remove results, media and job records past their retention, and what killed processes leave behind.

        At most `sweep.BATCH` of a kind. Returns a number that is 0 when nothing was past its retention.
        """
        try:
            removed = self._expire_records()
        except DBAPIError as error:
            if not is_disk_full(error):
                raise
            removed = self._expire_records(frees=True)  # the reserve is for what is past its retention, not for a look
        self._drafts.clear()
        clear_remains(self._settings)
        return removed

    def _expire_records(self, *, frees: bool = False) -> int:
        now = self._database.now()
        with self._database.write(frees=frees) as session:
            removed = len(sweep.expire_results(session, now=now))
            late = sweep.late_media(session, now=now)
        removed += sum(self._expire_medium(media_id, now, frees=frees) for media_id in late)
        with self._database.write(frees=frees) as session:
            removed += sweep.expire_uploads(session, now=now)
            removed += sweep.expire_jobs(session, before=now - timedelta(seconds=self._settings.job_ttl_s))
            removed += previews.expire(session, now=now)
            removed += idempotency.expire(session, now=now, limit=sweep.BATCH)
            removed += sweep.expire_months(session, now=now, keep_months=self._settings.usage_months)
        return removed

    def _expire_medium(self, media_id: str, now: datetime, *, frees: bool) -> int:
        """In a transaction of its own: one that cannot be removed keeps no others. Returns the number of its blobs."""
        try:
            with self._database.write(frees=frees) as session:
                return len(sweep.expire_medium(session, media_id, now=now))
        except Exception as error:
            if is_outage(error) or is_disk_full(error):  # of all, and not of this one
                raise
            log.exception("a medium past its retention could not be removed", medium=media_id)
            return 0

    def delete(self) -> int:
        """Delete the blobs that no record names any more, and leave no trace of the records that did.

        At most a batch of them. Returns the number of those that are gone.
        """
        deleted = self._blobs.sweep()
        self._database.forget()
        return deleted

    def clear(self) -> int:
        """Do at once what the rounds do little by little, but for `Database.forget`. Returns how many files are gone.

        What the storage does not delete now is left to the rounds.
        """
        while self.expire():
            pass
        return sum(iter(self._blobs.sweep, 0))
