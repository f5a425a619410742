"""The one task: its message is a job id."""

from __future__ import annotations

from functools import cache

from celery.exceptions import Reject
from celery.signals import worker_process_init

from service.queue import TASK
from worker.acknowledging import CheckedRequest
from worker.app import app, sandbox, settings
from worker.runner import Runner
from worker.sandbox import Sandbox
from worker.stopping import StoppedError


@cache
def _runner() -> Runner:
    """One runner a pool child, made after the fork: connections must not be shared between processes."""
    return Runner(settings, app, Sandbox(sandbox.lobby))


@worker_process_init.connect  # type: ignore[untyped-decorator]
def _prepare(**_: object) -> None:
    _runner()  # so that the first job does not wait for it


@app.task(name=TASK, Request=CheckedRequest)  # type: ignore[untyped-decorator]
def run_job(job_id: str) -> None:
    """Do a job, if it can still be claimed."""
    try:
        _runner().run(job_id)
    except StoppedError as error:  # its message is another worker's
        raise Reject(requeue=True) from error
