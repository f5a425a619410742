"""The producer: hands job ids to the broker from a thread of its own, so that no request ever waits for it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable

import structlog
from celery import Celery

from service.catalog import Database, Message, jobs
from service.queue.broker import TASK, celery_settings
from service.settings import Settings

log = structlog.get_logger(__name__)


def make_producer(settings: Settings) -> Celery:
    """A Celery app that only sends."""
    producer = Celery("pvg-service", set_as_current=False)
    producer.conf.update(celery_settings(settings))
    # when the broker is away, the reaper sends the message later
    producer.conf.broker_transport_options |= {"max_retries": 1, "interval_start": 0.1}
    return producer


def send(producer: Celery, message: Message) -> None:
    """Hand one message to the broker. Raises the broker's error at once, without trying again."""
    producer.send_task(TASK, args=[message.job_id], queue=message.queue, ignore_result=True, retry=False)


class Publisher:
    """Sends messages in the background. What cannot be sent stays unpublished, and the reaper tries again."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._producer = make_producer(settings)
        self._database = database
        self._pending: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="publisher", daemon=True)

    def start(self) -> None:
        """Start sending."""
        self._thread.start()

    def stop(self) -> None:
        """Send what is pending, then stop; gives up after a few seconds, as the reaper sends the rest."""
        self._pending.put(None)
        self._thread.join(timeout=5)

    def publish(self, messages: Iterable[Message]) -> None:
        """Queue messages for sending. Returns at once and never fails."""
        for message in messages:
            self._pending.put(message)

    def depth(self, name: str) -> int:
        """How many messages the broker holds in a queue. Raises when the broker does not answer."""
        with self._producer.connection_for_read() as connection:
            connection.ensure_connection(max_retries=1, timeout=2)
            with connection.channel() as channel:
                return int(channel.queue_declare(name, durable=True, passive=False).message_count)

    def _run(self) -> None:
        while (message := self._pending.get()) is not None:
            try:
                send(self._producer, message)
            except Exception as error:
                log.warning("publish failed", job=message.job_id, error=type(error).__name__)
                continue
            try:
                with self._database.write() as session:
                    jobs.mark_published(session, message.job_id, now=self._database.now())
            except Exception:  # the message is out; a second one does no harm
                log.exception("marking a job as published failed", job=message.job_id)
