"""What the routes of videos and references have in common."""

from __future__ import annotations

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from service.api import commands
from service.api.multipart import read_form
from service.api.schemas import MediaBody, MediaPage
from service.api.services import Services
from service.api.uploads import Intake
from service.api.views import media_body
from service.catalog import Role, media
from service.errors import BadRequestError, NotFoundError, UnsupportedMediaError


async def upload(services: Services, role: Role, request: Request, response: Response) -> MediaBody:
    """Receive a file, raw or as the form field `file`. 202 when it will be vectorised, 200 when it is known."""
    declared = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if declared == "application/json":
        raise UnsupportedMediaError("send the file itself, as the body or as the form field `file`")
    async with Intake(services.storage, request, limit_bytes=services.settings.max_upload_bytes) as intake:
        if declared == "multipart/form-data":
            form = await read_form(intake)
            if [name for name, _ in form.files] != ["file"] or form.fields:
                raise BadRequestError("the form must hold one file, in the field `file`, and nothing else")
            received = form.files[0][1]
        else:
            received = await intake.raw()
        found, pending = await run_in_threadpool(commands.register, services, role, received)
    response.status_code = 202 if pending else 200
    response.headers["Location"] = f"{services.settings.root_path}/{role.value}s/{found.id}"
    return media_body(found)


def show(services: Services, role: Role, media_id: str) -> MediaBody:
    """One medium. Raises `NotFoundError`."""
    with services.database.read() as session:
        found = media.get(session, media_id)
    if found is None or found.role != role:
        raise NotFoundError(f"there is no {role.value} {media_id}")
    return media_body(found)


def page(services: Services, role: Role, cursor: str | None, limit: int) -> MediaPage:
    """A page of media, newest first."""
    with services.database.read() as session:
        found = media.page(session, role, before=cursor, limit=limit + 1)
    shown = found[:limit]
    more = shown[-1].id if len(found) > limit else None
    return MediaPage(data=[media_body(one) for one in shown], next_cursor=more)
