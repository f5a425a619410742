"""A worker says that it is alive, and waits until it has what every job needs."""

from __future__ import annotations

import threading
import time
from typing import Final

import structlog

from pvg.models import ModelError, check
from service.catalog import Database, workers
from service.catalog.workers import Kind
from service.drafts import Drafts
from service.ids import worker_id
from service.outages import is_disk_full
from service.settings import Settings
from service.spool import Spool
from worker import connection

log = structlog.get_logger(__name__)

#: what a worker without its networks lacks, as /readyz shows it
WEIGHTS: Final = "network weights"


def wait_for_weights(settings: Settings) -> None:
    """Return once the networks are there. Until then no job is taken, and /readyz says why."""
    if _has_weights():
        return
    database = Database(settings.database)
    try:
        while not _has_weights(quietly=True):
            _beat(database, lacks=WEIGHTS)
            time.sleep(settings.heartbeat_s)
        _leave(database)
    finally:
        database.close()  # this process is forked from later


def _has_weights(*, quietly: bool = False) -> bool:
    try:
        check()
    except ModelError as error:
        if not quietly:
            log.error("no job is taken before the network weights are there", reason=str(error))
        return False
    return True


class Heartbeat:
    """A thread of a process that works; it speaks until the process ends, and clears drafts that others left."""

    def __init__(self, settings: Settings, *, kind: Kind = "jobs") -> None:
        self._settings = settings
        self._kind = kind
        self._spool: Spool | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def start(self) -> None:
        """Begin to speak."""
        self._thread.start()

    def stop(self) -> None:
        """The process ends: say so, if that takes no time."""
        self._stop.set()
        self._thread.join(1)

    def _run(self) -> None:
        database = Database(self._settings.database)
        before = None
        while True:
            lacks = self._lacks()
            if lacks is not None and lacks != before:
                log.warning("this process can do no work", lacks=lacks)
            _beat(database, lacks=lacks, kind=self._kind)
            before = lacks
            self._clear(database)
            if self._stop.wait(self._settings.heartbeat_s):
                break
        _leave(database)
        database.close()

    def _lacks(self) -> str | None:
        """What keeps this process from work; a full disk is told with the jobs that wait for room."""
        if connection.is_missed():
            return workers.BROKER
        try:
            if self._spool is None:
                self._spool = Spool(self._settings.spool_folder)
            self._spool.check_drafts()
        except OSError as error:
            return None if is_disk_full(error) else workers.DISK
        return None

    def _clear(self, database: Database) -> None:
        if self._spool is None:
            return
        try:
            Drafts(database, self._spool, self._settings).clear()
        except Exception as error:  # after the next beat
            log.warning("drafts not cleared", error=type(error).__name__)


def _beat(database: Database, lacks: str | None = None, kind: Kind = "jobs") -> None:
    try:
        with database.write() as session:
            workers.beat(session, worker_id(), now=database.now(), lacks=lacks, kind=kind)
    except Exception as error:  # the next one may arrive
        log.warning("heartbeat not written", error=type(error).__name__)


def _leave(database: Database) -> None:
    try:
        with database.write() as session:
            workers.leave(session, worker_id())
    except Exception as error:  # it is found silent a little later
        log.warning("heartbeat not ended", error=type(error).__name__)
