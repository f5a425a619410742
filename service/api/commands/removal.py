"""Media and jobs are deleted with all that comes of them, and what a refused request brought is taken back."""

from __future__ import annotations

from collections.abc import Sequence

import structlog

from service.api import lookups
from service.api.conditional import etag_of
from service.api.ranges import require_match
from service.api.schemas import MediaBody
from service.api.services import Services
from service.api.views import media_body
from service.catalog import ENDED, Message, Role, jobs, keys, media, sweep
from service.errors import ConflictError, NotFoundError

log = structlog.get_logger(__name__)


async def remove(
    services: Services, owner: str, role: Role, media_id: str, *, cancel_jobs: bool, if_match: str | None
) -> None:
    """Delete a medium with everything derived from it: asset, results, and the file itself.

    Raises `NotFoundError`, `ConflictError` while jobs need it and ``cancel_jobs`` is false, and `PreconditionError`
    when ``if_match`` does not name it as it is.
    """
    gone = await services.calls.write(
        _remove, services, owner, role, media_id, cancel_jobs=cancel_jobs, if_match=if_match
    )
    await services.calls.remove(services.blobs.delete, gone)


def _remove(
    services: Services, owner: str, role: Role, media_id: str, *, cancel_jobs: bool, if_match: str | None
) -> list[str]:
    """Remove the records. Returns the blobs that are to go."""
    database = services.database
    with database.write(frees=True) as session:
        media.lock_job(session, media_id, owner=owner)
        found = media.get(session, media_id, owner=owner, lock="update")
        if found is None or found.role != role:
            raise NotFoundError(f"there is no {role.value} {media_id}")
        active = media.active_jobs(session, media_id)
        if active and not cancel_jobs:
            detail = f"{len(active)} job(s) still use {media_id}: {', '.join(active[:10])}"
            raise ConflictError(f"{detail}; wait for them, or delete with ?cancel_jobs=true")
        if if_match is not None:
            require_match(if_match, etag_of(media_body(found, services.settings).model_dump_json().encode()))
        gone, ended = sweep.delete_medium(session, found, active, now=database.now())
    services.publisher.withdraw(ended)
    return gone


async def remove_job(services: Services, owner: str, job_id: str, *, if_match: str | None) -> None:
    """Delete the record of a job that has ended, with its results.

    Raises `NotFoundError`, `ConflictError` while it goes on, or the medium that it vectorised is there, and
    `PreconditionError` when ``if_match`` does not name it as it is.
    """
    gone = await services.calls.write(_remove_job, services, owner, job_id, if_match)
    await services.calls.remove(services.blobs.delete, gone)


def _remove_job(services: Services, owner: str, job_id: str, if_match: str | None) -> list[str]:
    database = services.database
    with database.write(frees=True) as session:
        # no other request is answered with it meanwhile: one that asks for the same locks these before
        keys.lock(session, owner)
        looks = jobs.looks(session, job_id)
        media.several(session, owner, {one for look in looks for one in (look.video_id, look.reference_id)}, lock=True)
        job = jobs.get(session, job_id, owner=owner, lock=True)
        if job is None:
            raise NotFoundError(f"there is no job {job_id}")
        if job.state not in ENDED:
            raise ConflictError(f"{job_id} is {job.state}; cancel it, and delete it when it has ended")
        medium = None if job.media_id is None else media.get(session, job.media_id)
        if medium is not None and medium.job_id == job_id:
            raise ConflictError(f"{job_id} is what vectorised {job.media_id}; delete that first")
        if if_match is not None:
            body = lookups.of_job(services.settings, services.room, session, job, forecasts=services.forecasts)
            require_match(if_match, etag_of(body.model_dump_json().encode()))
        return sweep.delete_job(session, job_id, now=database.now())


async def take_back(services: Services, owner: str, brought: Sequence[MediaBody]) -> None:
    """Delete the media that a refused request has brought, but for those that others have asked for since.

    Never fails: they go after their retention.
    """
    if not brought:
        return
    try:
        gone = await services.calls.write(_take_back, services, owner, brought)
        await services.calls.remove(services.blobs.delete, gone)
    except Exception as error:
        log.warning("what a refused request has brought stays", count=len(brought), error=type(error).__name__)


def _take_back(services: Services, owner: str, brought: Sequence[MediaBody]) -> list[str]:
    gone: list[str] = []
    messages: list[Message] = []
    with services.database.write(frees=True) as session:
        for body in sorted(brought, key=lambda body: body.id):
            media.lock_job(session, body.id, owner=owner)
            found = media.get(session, body.id, owner=owner, lock="update")
            # whoever asks for it, or uses it, counts its retention anew
            if found is None or found.expires_at != body.expires_at:
                continue
            active = media.active_jobs(session, found.id)
            blobs, ended = sweep.delete_medium(session, found, active, now=services.database.now())
            gone += blobs
            messages += ended
    services.publisher.withdraw(messages)
    return gone
