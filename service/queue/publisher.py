"""The producer: hands job ids to the broker from a thread of its own, so that no request ever waits for it."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterable
from typing import Final

import structlog
from celery import Celery

from service.catalog import Database, Message, jobs
from service.outages import is_outage, told
from service.queue.broker import JOB_HEADER, PREVIEW, PREVIEW_TASK, TASK, celery_settings, sent_jobs, withdraw
from service.settings import Settings

#: messages whose jobs are marked as published in one transaction, and seconds for which more of them are waited for:
#: each transaction takes a turn from the requests that write
_BATCH: Final = 50
_GATHER_S: Final = 0.1

log = structlog.get_logger(__name__)


def make_producer(settings: Settings) -> Celery:
    """A Celery app that only sends."""
    producer = Celery("pvg-service", set_as_current=False)
    producer.conf.update(celery_settings(settings))
    # when the broker is away, the reaper sends the message later
    producer.conf.broker_transport_options |= {"max_retries": 1, "interval_start": 0.1}
    return producer


def send(producer: Celery, message: Message, task: str = TASK) -> None:
    """Hand one message to the broker. Raises the broker's error at once, without trying again."""
    headers = {JOB_HEADER: message.job_id}
    producer.send_task(
        task, args=[message.job_id], headers=headers, queue=message.queue, ignore_result=True, retry=False
    )


class Publisher:
    """Sends messages in the background. What cannot be sent stays unpublished, and the reaper tries again."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._settings = settings
        self._producer = make_producer(settings)
        self._database = database
        self._pending: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        #: what is in there: while the broker is away, the reaper comes with the same messages again and again
        self._waiting: set[Message] = set()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="publisher", daemon=True)

    def start(self) -> None:
        """Start sending."""
        self._thread.start()

    def stop(self) -> None:
        """Send what is pending, then stop; gives up after a few seconds, as the reaper sends the rest."""
        self._pending.put(None)
        self._thread.join(timeout=2)
        if self._thread.is_alive():
            log.warning("messages are left to the reaper", count=max(self._pending.qsize() - 1, 0))

    def publish(self, messages: Iterable[Message]) -> None:
        """Queue messages for sending, but for those that wait to be sent. Returns at once and never fails."""
        with self._lock:
            for message in messages:
                if message not in self._waiting:
                    self._waiting.add(message)
                    self._pending.put(message)

    def ask(self, preview_id: str) -> None:
        """Send for a single picture, at once. Raises the broker's error."""
        send(self._producer, Message(preview_id, PREVIEW), PREVIEW_TASK)

    def withdraw_preview(self, preview_id: str) -> None:
        """Take back the message of a picture that nobody waits for."""
        self.withdraw([Message(preview_id, PREVIEW)])

    def withdraw(self, messages: Iterable[Message]) -> None:
        """Take back messages of jobs that have ended without a worker."""
        for message in messages:
            try:
                withdraw(self._settings, message)
            except OSError as error:  # a worker passes over it
                log.warning("a message could not be taken back", job=message.job_id, error=error.strerror)

    def sent(self, name: str) -> set[str] | None:
        """The jobs whose messages the broker holds in a queue, or None where it can only count them: see `depth`."""
        return sent_jobs(self._settings, name)

    def depth(self, name: str) -> int:
        """How many messages the broker holds in a queue. Raises when the broker does not answer."""
        with self._producer.connection_for_read() as connection:
            connection.ensure_connection(max_retries=1, timeout=2)
            with connection.channel() as channel:
                return int(channel.queue_declare(name, durable=True, passive=False).message_count)

    def _run(self) -> None:
        while (message := self._next()) is not None:
            sent: list[Message] = []
            until = time.monotonic() + _GATHER_S
            while message is not None:
                try:
                    send(self._producer, message)
                    sent.append(message)
                except Exception as error:
                    log.warning("publish failed", job=message.job_id, **told(error))
                if len(sent) >= _BATCH:
                    break
                try:
                    message = self._next(max(0.0, until - time.monotonic()))
                except queue.Empty:
                    break
            self._mark(sent)
            if message is None:
                return

    def _next(self, timeout_s: float | None = None) -> Message | None:
        """The next message, or None at the end. Raises `queue.Empty` when none comes in time."""
        message = self._pending.get(timeout=timeout_s)
        if message is not None:
            with self._lock:
                self._waiting.discard(message)  # before it is sent: one that is asked for from now on is sent again
        return message

    def _mark(self, sent: list[Message]) -> None:
        """Remember what was sent, in one transaction; take back the messages of jobs that have ended meanwhile."""
        try:
            with self._database.write() as session:
                now = self._database.now()
                # in the order in which others lock several
                ordered = sorted(sent, key=lambda message: message.job_id)
                ended = [one for one in ordered if not jobs.mark_published(session, one.job_id, now=now)]
        except Exception as error:  # the messages are out; a second one does no harm
            say = log.warning if is_outage(error) else log.exception
            say("marking jobs as published failed", count=len(sent), error=type(error).__name__)
        else:
            self.withdraw(ended)
