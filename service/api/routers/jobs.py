"""/jobs: the state and progress of jobs, and their cancellation."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from service.api import commands, lookups
from service.api.authentication import Caller, CallerDep, check_again
from service.api.conditional import conditional
from service.api.dependencies import (
    MAX_WAIT_S,
    UNCHANGED,
    IfMatch,
    IfNoneMatch,
    JobCursor,
    JobId,
    MetadataOf,
    PageSize,
    ServicesDep,
    WaitSeconds,
    answer,
    problems,
)
from service.api.idempotency import Once, OnceDep
from service.api.metadata import to_metadata
from service.api.openapi import fields
from service.api.preferences import preferred_wait_s
from service.api.problems import invalid_values
from service.api.schemas import JobBody, JobPage
from service.api.services import Services
from service.catalog import Filter, JobKind, JobState, jobs, parts
from service.errors import ConflictError, NotFoundError

router = APIRouter(prefix="/jobs", tags=["jobs"])

_MAX_IDS = 200

JobIds = Annotated[
    str | None,
    Query(
        alias="id",
        description="up to 200 ids with commas between them, in one page unless `limit` is given; "
        "unknown ones are left out",
    ),
]
VideoOf = Annotated[
    str | None, Query(description="id of the video that is recoloured, or of the medium that is vectorised")
]
ReferenceOf = Annotated[str | None, Query(description="id of the medium whose colours are used, or that is vectorised")]


def load_job(services: Services, caller: Caller, job_id: str) -> JobBody:
    """The answer for a job. Raises `NotFoundError`."""
    with services.database.read() as session:
        job = jobs.get(session, job_id, owner=caller.owner)
        if job is None:
            raise NotFoundError(f"there is no job {job_id}")
        return lookups.of_job(services.settings, services.room, session, job, forecasts=services.forecasts)


@router.get("", response_model=JobPage, responses=UNCHANGED | problems())
async def list_jobs(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    ids: JobIds = None,
    video: VideoOf = None,
    reference: ReferenceOf = None,
    state: Annotated[list[JobState], Query(description="repeat it to accept any of several states")] = [],  # noqa: B006 - FastAPI copies it
    kind: Annotated[list[JobKind], Query(description="repeat it to accept any of several kinds")] = [],  # noqa: B006
    metadata: MetadataOf = [],  # noqa: B006
    cursor: JobCursor = None,
    limit: PageSize = 50,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """List jobs, newest first. All given filters must match."""
    named = None if ids is None else [one.strip().replace("\0", "") for one in ids.split(",") if one.strip()]
    if named is not None and len(named) > _MAX_IDS:
        raise invalid_values({"/query/id": f"at most {_MAX_IDS} ids"})
    video, reference = (one and one.replace("\0", "") for one in (video, reference))
    wanted = Filter(named, video, reference, state, kind, to_metadata(metadata, "/query/metadata"))
    # those that are named are no more than a page holds, unless a smaller one is asked for
    most = limit if named is None or "limit" in request.query_params else _MAX_IDS
    page = await services.calls.read(_page, services, caller, wanted, cursor, most)
    return conditional(if_none_match, page)


def _page(services: Services, caller: Caller, wanted: Filter, cursor: str | None, limit: int) -> JobPage:
    with services.database.read() as session:
        found = jobs.page(session, caller.owner, wanted, before=cursor, limit=limit + 1)
        shown = lookups.of_jobs(services.settings, services.room, session, found[:limit], forecasts=services.forecasts)
    return JobPage(data=shown, next_cursor=shown[-1].id if len(found) > limit else None)


@router.get("/{job_id}", response_model=JobBody, responses=UNCHANGED | problems(404), openapi_extra=fields("Prefer"))
async def get_job(
    job_id: JobId,
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    wait: WaitSeconds = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Get a job. With `wait` or `Prefer: wait=`, the answer comes when it is done, or after so many seconds."""
    headers: dict[str, str] = {}
    if request.method == "HEAD":
        wait = 0  # what would be waited for is not sent
    elif wait is None:
        preferred = preferred_wait_s(request.headers.getlist("prefer"), most_s=MAX_WAIT_S)
        if preferred is not None:
            headers["Preference-Applied"] = f"wait={preferred}"
        wait = preferred or 0
    body = await services.calls.read(load_job, services, caller, job_id)
    if body.done or not wait:
        return conditional(if_none_match, body, headers)
    # the job is the caller's: the watch asks nobody whose it is
    ended = await services.watch.end_of(job_id, wait)
    await check_again(services, caller)
    if ended is not None:
        return conditional(if_none_match, ended, headers)
    return conditional(if_none_match, await services.calls.read(load_job, services, caller, job_id), headers)


@router.post(
    "/{job_id}/cancel",
    status_code=202,
    responses=answer(200, JobBody, "it was canceled before") | problems(400, 404, 409, 507),
)
async def cancel_job(
    job_id: JobId, response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> JobBody:
    """Cancel a job. A queued job ends at once, a running one within about two seconds."""
    once.frees = True
    async with once:
        once.compare(None)
        done_now, body = await services.calls.write(_cancel, services, caller, once, job_id)
    response.status_code = 202 if done_now else 200
    return body


@router.delete("/{job_id}", status_code=204, response_class=Response, responses=problems(404, 409, 412, 507))
async def delete_job(job_id: JobId, services: ServicesDep, caller: CallerDep, if_match: IfMatch = None) -> None:
    """Delete an ended job with its results, its metadata and the deliveries of its webhooks."""
    await commands.remove_job(services, caller.owner, job_id, if_match=if_match)


def _cancel(services: Services, caller: Caller, once: Once, job_id: str) -> tuple[bool, JobBody]:
    """Cancel a job; False when it was canceled before. Raises `NotFoundError` and `ConflictError`."""
    now = services.database.now()
    with services.database.write(frees=True) as session:
        job = jobs.get(session, job_id, owner=caller.owner, lock=True)
        if job is None:
            raise NotFoundError(f"there is no job {job_id}")
        needless = [jobs.message_of(job), *parts.messages(session, [job_id])]
        done_now = jobs.cancel(session, job_id, now=now)
        session.refresh(job)
        if not done_now and job.state not in {JobState.CANCELING, JobState.CANCELED}:
            raise ConflictError(f"the job has already {job.state}")
        released = jobs.release(session, now=now)
        body = lookups.of_job(services.settings, services.room, session, job)
        once.keep(session, 202 if done_now else 200, body, location=None, resource_id=job_id)
    services.publisher.publish(released)
    services.publisher.withdraw(needless)
    return done_now, body
