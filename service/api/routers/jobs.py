"""/jobs: the state and progress of a job, and its cancellation."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter, Response
from starlette.concurrency import run_in_threadpool

from service.api.dependencies import JobId, ServicesDep, WaitSeconds, answer, problems
from service.api.schemas import JobBody
from service.api.services import Services
from service.api.views import job_body
from service.catalog import JobState, jobs
from service.errors import ConflictError, NotFoundError

router = APIRouter(prefix="/jobs", tags=["jobs"])

#: seconds between two checks of a job that a client waits for
POLL_S = 0.25


def load_job(services: Services, job_id: str) -> JobBody:
    """The answer for a job. Raises `NotFoundError`."""
    with services.database.read() as session:
        job = jobs.get(session, job_id)
        if job is None:
            raise NotFoundError(f"there is no job {job_id}")
        return job_body(job, jobs.looks(session, job_id), root_path=services.settings.root_path)


@router.get("/{job_id}", responses=problems(404))
async def show_job(job_id: JobId, services: ServicesDep, wait: WaitSeconds = 0) -> JobBody:
    """One job. With `wait` the answer comes when the job is done, or after so many seconds."""
    loop = asyncio.get_running_loop()
    until = loop.time() + wait
    while True:
        body = await run_in_threadpool(load_job, services, job_id)
        left = until - loop.time()
        if body.done or left <= 0:
            return body
        await asyncio.sleep(min(POLL_S, left))


@router.post(
    "/{job_id}/cancel",
    status_code=202,
    responses=answer(200, JobBody, "it was canceled before") | problems(404, 409, 507),
)
def cancel_job(job_id: JobId, response: Response, services: ServicesDep) -> JobBody:
    """Stop a job. A queued one ends at once; a running one when its worker has stopped."""
    now = services.database.now()
    with services.database.write() as session:
        done_now = jobs.cancel(session, job_id, now=now)
        job = jobs.get(session, job_id)
        if job is None:
            raise NotFoundError(f"there is no job {job_id}")
        if not done_now and job.state not in {JobState.CANCELING, JobState.CANCELED}:
            raise ConflictError(f"the job has already {job.state}")
        released = jobs.release(session, now=now)
    services.publisher.publish(released)
    response.status_code = 202 if done_now else 200
    return load_job(services, job_id)
