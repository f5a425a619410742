"""What a webhook says: that a job has ended, how, and where to ask for more."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from service import addresses
from service.catalog import Job, Look
from service.errors import shown
from service.settings import Settings


def event_type(job_state: str) -> str:
    """The type of the event of a job that has ended in this state, such as ``job.succeeded``."""
    return f"job.{job_state}"


def payload(job: Job, looks: Sequence[Look], settings: Settings) -> bytes:
    """The body, as JSON: made of the job's record each time, so that nothing outlives what is deleted."""
    assert job.finished_at is not None, "only what has ended is told"  # noqa: S101
    data: dict[str, Any] = {
        "id": job.id,
        "kind": job.kind,
        "state": job.state,
        "url": addresses.of_job(settings, job.id),
        "media": job.media_id,
        "looks": [{"video": look.video_id, "reference": look.reference_id, "result": look.result_id} for look in looks],
        "error": shown(job.error, settings.root_path),
        "metadata": job.metadata_,
        "created_at": _time(job.created_at),
        "finished_at": _time(job.finished_at),
    }
    event = {"type": event_type(job.state), "timestamp": _time(job.finished_at), "data": data}
    return json.dumps(event, ensure_ascii=False, separators=(",", ":")).encode()


def _time(moment: datetime) -> str:
    return moment.astimezone(UTC).isoformat().replace("+00:00", "Z")
