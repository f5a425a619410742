"""The queue between API and worker: what both ends must agree on, and the end that sends.

The message is a job id. The database is the source of truth, so the broker may lose or repeat messages.
"""

from __future__ import annotations

from service.queue.broker import (
    PREVIEW,
    PREVIEW_TASK,
    QUEUES,
    RENDER,
    TASK,
    VECTORIZE,
    celery_settings,
    clear_remains,
    make_folders,
    withdraw,
)
from service.queue.publisher import Publisher, make_producer, send

__all__ = [
    "PREVIEW",
    "PREVIEW_TASK",
    "QUEUES",
    "RENDER",
    "TASK",
    "VECTORIZE",
    "Publisher",
    "celery_settings",
    "clear_remains",
    "make_folders",
    "make_producer",
    "send",
    "withdraw",
]
