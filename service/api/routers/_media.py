"""What the routes of videos and references have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fastapi import Request, Response
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from service.api import commands
from service.api.multipart import read_form
from service.api.problems import invalid, invalid_values
from service.api.schemas import MediaBody, MediaPage, ReferenceOptions
from service.api.services import Services
from service.api.uploads import Intake
from service.api.views import media_body
from service.catalog import Role, VectorSettings, media
from service.errors import BadRequestError, NotFoundError, UnsupportedMediaError


@dataclass(frozen=True)
class Given:
    """The settings of a vectorisation as the query has them: None where it says nothing."""

    options: type[ReferenceOptions]
    query: dict[str, str | None]

    def settings(self, fields: Sequence[tuple[str, str]] = ()) -> VectorSettings:
        """The settings of query and form together. Raises `ValidationFailedError` for one that is unknown or twice."""
        said = {name: value for name, value in self.query.items() if value is not None}
        names = [*said, *(name for name, _ in fields)]
        if twice := {name for name in names if names.count(name) > 1}:
            raise invalid_values({f"/{name}": "the setting is given more than once" for name in sorted(twice)})
        try:
            checked = self.options.model_validate(said | dict(fields))
        except ValidationError as error:
            raise invalid(error) from error
        return VectorSettings(**checked.model_dump())


async def upload(services: Services, role: Role, request: Request, response: Response, given: Given) -> MediaBody:
    """Receive a file, raw or as the form field `file`. 202 when it will be vectorised, 200 when it is known."""
    declared = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if declared == "application/json":
        raise UnsupportedMediaError("send the file itself, as the body or as the form field `file`")
    async with Intake(services.storage, request, limit_bytes=services.settings.max_upload_bytes) as intake:
        if declared == "multipart/form-data":
            form = await read_form(intake)
            known = given.options.model_fields
            if [name for name, _ in form.files] != ["file"] or any(name not in known for name, _ in form.fields):
                allowed = " and ".join(f"`{name}`" for name in known)
                raise BadRequestError(f"the form must hold one file, in the field `file`, and may hold {allowed}")
            received, settings = form.files[0][1], given.settings(form.fields)
        else:
            received, settings = await intake.raw(), given.settings()
        found, pending = await run_in_threadpool(commands.register, services, role, received, settings)
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
