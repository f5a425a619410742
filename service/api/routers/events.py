"""/jobs/{id}/events: a job as it goes on, by Server-Sent Events (HTML, 9.2), for as long as the client listens."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator, Mapping
from dataclasses import astuple
from typing import Annotated, Final

from fastapi import APIRouter, Header, Response
from starlette.responses import StreamingResponse

from service.api.authentication import Caller, CallerDep, check_again
from service.api.dependencies import JobId, Responses, ServicesDep, problems
from service.api.services import Services, load_snapshots
from service.api.streams import EventStream
from service.api.waiting import Snapshot
from service.catalog import ENDED, jobs
from service.catalog.jobs import Standing
from service.errors import NotFoundError, UnauthorizedError, UnavailableError
from service.outages import is_outage

router = APIRouter(prefix="/jobs", tags=["jobs"])

#: seconds of silence after which a comment is sent: proxies close what is silent
HEARTBEAT_S: Final = 15.0
#: after which a stream ends and its client comes again, with its key, and with `Last-Event-ID`
MAX_STREAM_S: Final = 3600.0
#: milliseconds after which it should
_RETRY_MS: Final = 2000

LastEventId = Annotated[
    str | None, Header(description="`id` of the last event that arrived; that event is not repeated")
]


#: of an event. The media type has no structure of its own: tools take its schema for that of the text or of each event
_EVENT: Final = {
    "title": "JobEvent",
    "type": "object",
    "properties": {
        "id": {"type": "string", "description": "for Last-Event-ID"},
        "event": {"type": "string", "enum": ["state", "progress"]},
        "data": {"type": "string", "contentMediaType": "application/json", "description": "a JobBody"},
        "retry": {"type": "integer", "description": "milliseconds after which to connect again"},
    },
}
_ANSWERS: Responses = {
    200: {
        "content": {"text/event-stream": {"schema": {"anyOf": [{"type": "string"}, _EVENT]}}},
        "description": "events `state` and `progress`, each with the job as GET /jobs/{id} answers it",
    },
    204: {"description": "its end was told before: do not connect again"},
}


@router.get("/{job_id}/events", response_class=StreamingResponse, responses=_ANSWERS | problems(404))
async def get_job_events(
    job_id: JobId, services: ServicesDep, caller: CallerDep, last_event_id: LastEventId = None
) -> Response:
    """Listen to a job: a stream of Server-Sent Events, its present state first, then each change until it has ended."""
    now = await services.calls.read(_load, services, caller, job_id)
    if now.standing.has_ended and last_event_id is not None and last_event_id.partition(".")[0] in ENDED:
        return Response(status_code=204)
    return EventStream(services.streams, caller.owner, _events(services, caller, now, job_id, last_event_id))


def _load(services: Services, caller: Caller, job_id: str) -> Snapshot:
    with services.database.read() as session:
        known = jobs.get(session, job_id, owner=caller.owner) is not None
    found: dict[str, Snapshot] = {}
    if known:
        parts = (services.settings, services.room, services.forecasts)
        found = load_snapshots(services.database, [job_id], *parts)
    if job_id not in found:
        raise NotFoundError(f"there is no job {job_id}")
    return found[job_id]


async def _events(
    services: Services, caller: Caller, now: Snapshot, job_id: str, last_id: str | None
) -> AsyncIterator[bytes]:
    until = asyncio.get_running_loop().time() + MAX_STREAM_S
    yield f"retry: {_RETRY_MS}\n\n".encode()
    if last_id != event_id(now.standing, now.position):
        yield _event("state", now)
    while not now.standing.has_ended and not services.watch.is_closed:
        if asyncio.get_running_loop().time() >= until:
            return
        changed = await services.watch.change_of(job_id, now, HEARTBEAT_S)
        if not await _may_hear_more(services, caller):
            return
        if changed is None:
            if not await _is_there(services, job_id):
                return
            yield b":\n\n"
            continue
        yield _event("state" if _phase(changed.standing) != _phase(now.standing) else "progress", changed)
        now = changed


async def _may_hear_more(services: Services, caller: Caller) -> bool:
    try:
        await check_again(services, caller)
    except UnauthorizedError:
        return False
    except Exception as error:  # asked again at the next event
        if not is_outage(error) and not isinstance(error, UnavailableError):
            raise
    return True


async def _is_there(services: Services, job_id: str) -> bool:
    """False once the record of a job is deleted; who comes again is told so."""
    try:
        return bool(await services.calls.read(_stand, services, job_id))
    except Exception as error:  # asked again at the next heartbeat
        if not is_outage(error) and not isinstance(error, UnavailableError):
            raise
    return True


def _stand(services: Services, job_id: str) -> Mapping[str, Standing]:
    with services.database.read() as session:
        return jobs.standings(session, [job_id])


def event_id(standing: Standing, position: int | None = None) -> str:
    """Names how a job stands, and where in the queue: its state, and a hash of the rest.

    The end of a job is known by its state alone.
    """
    told = repr((*astuple(standing), position))
    return f"{standing.state}.{hashlib.sha256(told.encode()).hexdigest()[:16]}"


def _phase(standing: Standing) -> tuple[str, int, bool]:
    return standing.state, standing.attempt, standing.waiting


def _event(name: str, snapshot: Snapshot) -> bytes:
    # JSON of pydantic has no line breaks
    told = event_id(snapshot.standing, snapshot.position)
    return b"id: %s\nevent: %s\ndata: %s\n\n" % (told.encode(), name.encode(), snapshot.body)
