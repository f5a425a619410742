"""What the routes of videos and references have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import PurePath
from typing import Annotated

from fastapi import Depends, Query, Request, Response
from pydantic import ValidationError

from service.api import commands
from service.api.authentication import Caller
from service.api.commands import Asked
from service.api.conditional import conditional
from service.api.dependencies import MetadataOf, PageSize, Responses, answer, problems
from service.api.downloads import BytesAsked, File, send_file
from service.api.fetches import while_connected
from service.api.idempotency import Once
from service.api.json_body import media_type, read_json, unsupported
from service.api.metadata import to_metadata
from service.api.multipart import CURL_SENDS_FILES, read_form
from service.api.problems import file_at, given_twice, invalid, invalid_values
from service.api.receivers import receiver, receiver_of_fields
from service.api.schemas import MediaBody, MediaPage, ReferenceByUrl, ReferenceOptions, VideoByUrl, WebhookRequest
from service.api.services import Services
from service.api.uploads import Intake, ReceivedFile
from service.api.views import media_body
from service.catalog import Media, MediaState, Role, VectorSettings, media
from service.errors import BadRequestError, NotFoundError


@dataclass(frozen=True)
class Given:
    """The settings of a vectorisation as the query has them: None where it says nothing."""

    options: type[ReferenceOptions]
    by_url: type[ReferenceByUrl | VideoByUrl]
    query: dict[str, str | None]
    metadata: Sequence[str] = ()
    webhook: str | None = None

    def settings(self, fields: Sequence[tuple[str, str]] = ()) -> VectorSettings:
        """The settings of query and form together. Raises `ValidationFailedError` for one that is unknown or twice."""
        said = {name: value for name, value in self.query.items() if value is not None}
        if twice := given_twice([*said, *(name for name, _ in fields)]):
            raise invalid_values({f"/{name}": "the setting is given more than once" for name in twice})
        try:
            checked = self.options.model_validate(said | dict(fields))
        except ValidationError as error:
            raise invalid(error) from error
        return VectorSettings(**checked.model_dump())

    def metadata_with(self, others: Sequence[str] = ()) -> dict[str, str]:
        """The metadata of the query and of the body together. Raises as `to_metadata`."""
        return to_metadata([*self.metadata, *others], "/query/metadata" if self.metadata else "/metadata")

    def receiver(self, services: Services) -> str | None:
        """The receiver that the query names. Raises `UrlNotAllowedError`."""
        if self.webhook is None:
            return None
        return receiver(services, WebhookRequest(url=self.webhook), "/query/webhook")


@dataclass(frozen=True)
class _Received:
    """A file with what was said of it."""

    file: ReceivedFile
    settings: VectorSettings
    metadata: dict[str, str]
    #: who is told when it is vectorised
    webhook: str | None = None


def upload_answers() -> Responses:
    """The documentation of the answers to a file. Of each route its own: the schema is completed in place."""
    return answer(200, MediaBody, "the same file with the same settings is there already") | problems(
        400, 409, 413, 415, 507
    )


async def upload(
    services: Services,
    caller: Caller,
    once: Once,
    role: Role,
    request: Request,
    response: Response,
    given: Given,
    *,
    only: str | None = None,
) -> MediaBody:
    """Receive a file: raw, as the form field `file`, or by its URL.

    202 when it will be vectorised, 200 when it is known. ``only`` is the one type of body that its address takes.
    """
    if only is not None and media_type(request) != only:
        raise unsupported(request, only)
    limit_bytes = services.settings.max_upload_bytes
    async with (
        once,
        services.arriving.place(caller.owner, free="again" if once.answered else None) as share,
        Intake(services.storage.spool, services.room, request, limit_bytes=limit_bytes, share=share) as intake,
    ):
        if media_type(request) == "application/json":
            found = await _fetch(services, caller, intake, once, given)
        else:
            found = await _receive(services, intake, given)
            file = found.file
            once.compare([file.sha256, file.filename, asdict(found.settings), found.metadata, found.webhook])
        asked = Asked(caller.owner, once, metadata=found.metadata, webhook=found.webhook)
        registered = await commands.register(services, role, found.file, found.settings, asked=asked)
    response.status_code = 202 if registered.pending else 200
    response.headers["Location"] = registered.location
    return registered.body


async def _receive(services: Services, intake: Intake, given: Given) -> _Received:
    of_query = given.receiver(services)  # what is wrong with the query is said before the file comes
    if media_type(intake.request) != "multipart/form-data":
        settings, metadata = given.settings(), given.metadata_with()
        return _Received(await intake.raw(), settings, metadata, of_query)
    form = await read_form(intake)
    known = given.options.model_fields
    fields = [(name, text) for name, text in form.fields if name not in {"metadata", "webhook"}]
    if not form.files and any(name == "file" for name, _ in fields):
        raise BadRequestError(f"the field `file` of the form is a text; {CURL_SENDS_FILES}")
    if [name for name, _ in form.files] != ["file"] or any(name not in known for name, _ in fields):
        allowed = " and ".join(f"`{name}`" for name in (*known, "metadata", "webhook"))
        raise BadRequestError(f"the form must hold one file, in the field `file`, and may hold {allowed}")
    metadata = given.metadata_with([text for name, text in form.fields if name == "metadata"])
    named = [text for name, text in form.fields if name == "webhook"]
    webhook = _one_of(of_query, receiver_of_fields(services, named))
    return _Received(form.files[0][1], given.settings(fields), metadata, webhook)


def _one_of(of_query: str | None, of_body: str | None) -> str | None:
    """The receiver of the query or of the body. Raises `ValidationFailedError` when both name one."""
    if of_query is not None and of_body is not None:
        raise invalid_values({"/query/webhook": "the body names a receiver too"})
    return of_query or of_body


async def _fetch(services: Services, caller: Caller, intake: Intake, once: Once, given: Given) -> _Received:
    wanted = await read_json(intake.request, given.by_url, limit_bytes=services.settings.max_json_bytes)
    said = [name for name in given.options.model_fields if name in wanted.model_fields_set]
    settings = given.settings([(name, getattr(wanted, name)) for name in said])
    metadata = given.metadata_with([f"{name}:{value}" for name, value in wanted.metadata.items()])
    webhook = _one_of(given.receiver(services), receiver(services, wanted.webhook))
    once.compare([wanted.url, asdict(settings), metadata, webhook])
    with services.fetches.place(caller.owner), file_at("/url"):
        file = await while_connected(intake.request, intake.fetch(services.egress, wanted.url, owner=caller.owner))
    return _Received(file, settings, metadata, webhook)


def show(services: Services, caller: Caller, role: Role, media_id: str, if_none_match: str | None) -> Response:
    """One medium. Raises `NotFoundError`."""
    return conditional(if_none_match, media_body(_get(services, caller, role, media_id), services.settings))


async def send(services: Services, caller: Caller, role: Role, media_id: str, asked: BytesAsked) -> Response:
    """The very file that was uploaded. Raises `NotFoundError`, and what `send_file` raises."""
    found = await services.calls.read(_get, services, caller, role, media_id)
    name = found.filename or f"{found.id}{PurePath(found.source_key).suffix}"
    file = File(found.source_key, found.sha256, found.size_bytes, found.content_type, name, of=found.id)
    return await send_file(services, asked, file)


def _get(services: Services, caller: Caller, role: Role, media_id: str) -> Media:
    with services.database.read() as session:
        found = media.get(session, media_id, owner=caller.owner)
    if found is None or found.role != role:
        raise NotFoundError(f"there is no {role.value} {media_id}")
    return found


@dataclass(frozen=True)
class PageOf:
    """Which media to list: in any of these states, with all of this metadata."""

    states: Sequence[MediaState]
    metadata: dict[str, str]
    limit: int


async def page_asked(
    state: Annotated[list[MediaState], Query(description="repeat it to accept any of several states")] = [],  # noqa: B006 - FastAPI copies it
    metadata: MetadataOf = [],  # noqa: B006
    limit: PageSize = 50,
) -> PageOf:
    """The parameters of a list of media, but for the cursor, which is of its kind alone."""
    return PageOf(state, to_metadata(metadata, "/query/metadata"), limit)


PageDep = Annotated[PageOf, Depends(page_asked)]


def page(services: Services, caller: Caller, role: Role, asked: PageOf, cursor: str | None) -> MediaPage:
    """A page of media, newest first."""
    limit = asked.limit
    with services.database.read() as session:
        found = media.page(
            session,
            role,
            owner=caller.owner,
            states=asked.states,
            metadata=asked.metadata,
            before=cursor,
            limit=limit + 1,
        )
    shown = found[:limit]
    more = shown[-1].id if len(found) > limit else None
    return MediaPage(data=[media_body(one, services.settings) for one in shown], next_cursor=more)
