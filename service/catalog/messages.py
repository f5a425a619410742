"""What the broker is told of: a job, and the queue of its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from service.catalog.models import JobKind, PartKind

#: the queue of each kind of job
QUEUE_OF: Final[Mapping[JobKind | PartKind, str]] = {
    JobKind.VECTORIZE: "vectorize",
    JobKind.TRANSFER: "render",
    JobKind.SWAP: "render",
    PartKind.PART: "render",
    PartKind.JOIN: "render",
}


@dataclass(frozen=True)
class Message:
    """A job to publish, and its queue."""

    job_id: str
    queue: str
