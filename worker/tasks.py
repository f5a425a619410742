"""The one task: its message is a job id."""

from __future__ import annotations

from functools import cache

from service.queue import TASK
from worker.acknowledging import CheckedRequest
from worker.app import app, settings
from worker.runner import Runner


@cache
def _runner() -> Runner:
    """One runner a pool child, made after the fork: connections must not be shared between processes."""
    return Runner(settings, app)


@app.task(name=TASK, Request=CheckedRequest)  # type: ignore[untyped-decorator]
def run_job(job_id: str) -> None:
    """Do a job, if it can still be claimed."""
    _runner().run(job_id)
