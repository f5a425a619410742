"""A busy worker notices that its broker is lost."""

from __future__ import annotations

from celery.worker.request import Request
from kombu.asynchronous import get_event_loop

#: seconds after which a message that was to be acknowledged is looked at: Celery does it in its loop, a moment later
CHECK_S = 1.0


class CheckedRequest(Request):  # type: ignore[misc]
    """A Celery request that treats a failed acknowledgement as what it is: a broken connection.

    Celery logs it and goes on. The message then counts against the prefetch limit for ever. A worker all of whose
    messages are of that kind requests no more from its broker, and so never notices that the connection is broken.
    """

    def acknowledge(self) -> None:
        """Acknowledge the message, and look a moment later whether that worked."""
        super().acknowledge()
        loop = get_event_loop()  # the embedded broker works without one, and cannot be lost
        if loop is not None:
            loop.call_later(CHECK_S, self._check)  # type: ignore[no-untyped-call]

    def _check(self) -> None:
        if not self._message.acknowledged:
            raise ConnectionError("a message could not be acknowledged")  # Celery connects again
