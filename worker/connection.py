"""Whether the worker's consumer is connected to its broker, known to every process of the worker."""

from __future__ import annotations

import time
from typing import Any, Final

from celery import bootsteps
from celery.worker.consumer import Consumer
from kombu.asynchronous import set_event_loop

from worker.shared_moment import SharedMoment

#: seconds for which a broker may be away before a worker says that it lacks it: restarts take less, and lose nothing
TOLERATED_S: Final = 60.0
#: seconds between two tries to use a broker that can be reached
_PAUSE_S: Final = 2.0

#: what Celery is told of its consumer, of jobs and of previews alike
SETTINGS: Final[dict[str, Any]] = {
    "worker_consumer": "worker.connection:PatientConsumer",
    "worker_prefetch_multiplier": 1,
    "worker_send_task_events": False,
    "worker_disable_rate_limits": True,
    "broker_connection_retry": True,
    "broker_connection_max_retries": None,
}

#: since when there has been no connection
_lost: Final = SharedMoment()


def is_missed() -> bool:
    """The consumer has been without its broker for too long, counted from when it first looked for it."""
    since = _lost.at
    return since is not None and time.monotonic() - since > TOLERATED_S


def lose() -> None:
    """There is no connection; says nothing new when there was none."""
    _lost.begin(time.monotonic())


def find() -> None:
    """The consumer asks its broker for messages."""
    _lost.clear()


class PatientConsumer(Consumer):  # type: ignore[misc]
    """Celery's consumer, which waits a moment after a broker that can be reached and does not do what it is asked.

    Celery connects again at once. A Redis that only reads, as after a failover or on a full disk, would be asked some
    times a second for as long as that lasts, with as many lines in the log.

    It knows its event loop after a lost connection too, which `worker.acknowledging` asks for.
    """

    def connect(self) -> Any:
        """Connect to the broker; the event loop is this worker's again: kombu forgets it with each lost connection."""
        if self.hub is not None:
            set_event_loop(self.hub)
        return super().connect()

    def on_connection_error_before_connected(self, exc: Exception) -> None:
        """There is no connection: one that cannot be had at all is waited for elsewhere."""
        super().on_connection_error_before_connected(exc)
        time.sleep(_PAUSE_S)


class Watched(bootsteps.StartStopStep):  # type: ignore[misc]
    """The step of Celery's consumer after the one that asks for messages: it is stopped when the connection is lost."""

    requires = ("celery.worker.consumer.tasks:Tasks",)

    def start(self, parent: Any) -> None:
        """The steps before it are done."""
        find()

    def stop(self, parent: Any) -> None:
        """The connection is lost, or the worker stops."""
        lose()
