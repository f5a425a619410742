"""/uploads: files that arrive in pieces, by tus 1.0, and links by which one file may come without a key."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from email.utils import format_datetime
from typing import Annotated, Final
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request, Response
from starlette.requests import ClientDisconnect

from service import addresses
from service.api import quotas, tus
from service.api.authentication import Caller, CallerDep
from service.api.commands import pieces, resuming
from service.api.dependencies import PageSize, Responses, ServicesDep, UploadCursor, UploadId, problems
from service.api.idempotency import Once, OnceDep, Replay
from service.api.json_body import media_type, read_json
from service.api.links import Access, AccessDep
from service.api.multipart import read_form
from service.api.openapi import fields, file_body, file_form, json_body
from service.api.receivers import receiver
from service.api.schemas import UploadBody, UploadLinkBody, UploadLinkRequest, UploadPage, VideoOptions
from service.api.services import Services
from service.api.uploads import Intake
from service.catalog import ResumableUpload, Role, keys, media, resumable
from service.errors import BadRequestError, ConflictError, GoneError, UnsupportedMediaError

router = APIRouter(prefix="/uploads", tags=["uploads"])
#: what a link opens as well as a key does
open_router = APIRouter(prefix="/uploads", tags=["uploads"])

_ALSO: Responses = {
    201: {"description": "begun in pieces"},
    204: {"description": "the bytes are taken, or the upload is deleted"},
}
_ANNOUNCED: Final = fields("Tus-Resumable", "Upload-Length", "Upload-Metadata")
_PIECE: Final = {
    **fields("Tus-Resumable", "Upload-Offset", "Upload-Checksum"),
    **file_body("The bytes from Upload-Offset on", tus.CONTENT_TYPE),
}


async def speak(request: Request) -> None:
    """What stands before all else: every answer says the version of tus, errors too."""
    # not a plain function: FastAPI would call that in a thread of its own
    request.state.answer_headers = {"Tus-Resumable": tus.VERSION}


@router.options("", status_code=204, responses=problems())
async def get_upload_protocol(services: ServicesDep) -> Response:
    """Tell which version and extensions of tus the service supports, in the fields of the answer."""
    told = {
        "Tus-Version": tus.VERSION,
        "Tus-Extension": tus.EXTENSIONS,
        "Tus-Max-Size": str(services.settings.max_upload_bytes),
        "Tus-Checksum-Algorithm": ",".join(tus.ALGORITHMS),
    }
    return Response(status_code=204, headers=told)


@router.get("", responses=problems())
async def list_uploads(
    services: ServicesDep, caller: CallerDep, cursor: UploadCursor = None, limit: PageSize = 50
) -> UploadPage:
    """List unfinished uploads and upload links, newest first, so that a client can go on with them or delete them."""
    return await services.calls.read(resuming.page, services, caller.owner, cursor, limit)


@router.post(
    "",
    status_code=201,
    responses=problems(400, 409, 412, 413, 415, 507),
    openapi_extra=_ANNOUNCED,
)
async def create_upload(
    request: Request, response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> UploadBody:
    """Begin an upload in pieces (tus creation). Upload-Length gives its size, Upload-Metadata what it is for."""
    tus.check_version(request.headers)
    size_bytes, said, raw = _announced(request)
    resuming.check_size(size_bytes, services.settings.max_upload_bytes)
    async with once:
        try:
            once.compare([size_bytes, said])
        except Replay as replay:
            replay.headers["Upload-Expires"] = _http_date(UploadBody.model_validate(replay.answer.body).expires_at)
            raise
        services.room.require(size_bytes)
        body = await services.calls.write(resuming.create, services, caller.owner, once, size_bytes, said, raw)
        if not once.is_named and await request.is_disconnected():
            await resuming.remove(services, body.id)  # nobody has heard of it, and it counts with its whole length
            raise ClientDisconnect
    response.headers["Location"] = addresses.of_upload(services.settings, body.id)
    response.headers["Upload-Expires"] = _http_date(body.expires_at)
    return body


def _http_date(time: datetime) -> str:
    return format_datetime(time, usegmt=True)


def _announced(request: Request) -> tuple[int, dict[str, str], str]:
    tus.check_whole(request.headers)
    raw = request.headers.get("upload-metadata", "")
    return tus.announced(request.headers), tus.metadata(raw), raw


@router.post(
    "/link",
    status_code=201,
    responses=problems(400, 409, 413, 415, 507),
    openapi_extra=json_body(UploadLinkRequest),
)
async def create_upload_link(
    request: Request, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> UploadLinkBody:
    """Make a link with which somebody without a key can upload one file. The body says what the file is for."""
    wanted = await read_json(request, UploadLinkRequest, limit_bytes=services.settings.max_json_bytes)
    async with once:
        once.compare(wanted.model_dump(mode="json"))
        services.room.require()
        return await services.calls.write(_make_link, services, caller, once, wanted)


def _make_link(services: Services, caller: Caller, once: Once, wanted: UploadLinkRequest) -> UploadLinkBody:
    role, webhook = Role(wanted.role), receiver(services, wanted.webhook)
    given = {name: getattr(wanted, name) for name in VideoOptions.model_fields if name in wanted.model_fields_set}
    settings = resuming.settings_of(role, given)
    limit = min(services.settings.max_upload_bytes, wanted.max_bytes or services.settings.max_upload_bytes)
    with services.database.write() as session:
        now = services.database.now()
        quotas.check(session, caller.owner, now=now, uploads=1)
        made = resumable.create(
            session,
            role,
            settings,
            owner=caller.owner,
            limit_bytes=limit,
            now=now,
            ttl_s=wanted.expires_in_s,
            metadata=wanted.metadata,
            webhook=webhook,
        )
        expires_at = (now + timedelta(seconds=wanted.expires_in_s)).replace(microsecond=0)
        seal = keys.seals(session, caller.owner, now=now)[0]
        query = urlencode(services.signer.sign("upload", made.id, by=caller.owner, seal=seal, expires_at=expires_at))
        url = f"{addresses.of_upload(services.settings, made.id)}?{query}"
        body = UploadLinkBody(id=made.id, url=url, expires_at=expires_at, max_bytes=limit)
        once.keep(session, 201, body, location=None, resource_id=made.id)
    return body


@dataclass(frozen=True)
class _Opened:
    """An upload, for a caller whose it is or the holder of a link to it."""

    upload: ResumableUpload
    by_link: bool

    def body(self, now: ResumableUpload | None = None) -> UploadBody:
        """The answer that shows it, as it is now; the medium is its owner's alone to see."""
        body = resuming.body_of(now or self.upload)
        return body if self._shows_medium else body.model_copy(update={"media": None})

    def progress(self, now: ResumableUpload | None = None) -> dict[str, str]:
        """The same for tus."""
        upload = now or self.upload
        headers = {"Upload-Offset": str(upload.offset_bytes)}
        if upload.media_id is None:
            headers["Upload-Expires"] = _http_date(upload.expires_at)
        elif self._shows_medium:
            headers["Pvg-Media"] = upload.media_id
        return headers

    @property
    def _shows_medium(self) -> bool:
        """Without keys everybody sees all media, so there is nothing to hide."""
        return not self.by_link or self.upload.owner == keys.NOBODY


async def _opened(request: Request, upload_id: UploadId, services: ServicesDep, access: AccessDep) -> _Opened:
    found = await services.calls.read(_open, services, upload_id, access)
    access.count(services, request.scope["state"], found.owner, found.id)
    return _Opened(found, access.by_link)


def _open(services: Services, upload_id: str, access: Access) -> ResumableUpload:
    with services.database.read() as session:
        try:
            access.to(services, session, "upload", upload_id)
        except GoneError:
            upload = resumable.get(session, upload_id, now=services.database.now())
            if upload is None or not upload.offset_bytes:  # a file that is on its way may come whole
                raise
        found = resuming.find_in(session, services, upload_id, access.owner)
        access.check_owner(session, found.owner)
    return found


UploadDep = Annotated[_Opened, Depends(_opened)]


@open_router.get("/{upload_id}", responses=problems(403, 404, 410))
async def get_upload(opened: UploadDep) -> UploadBody:
    """Get how much of a file has arrived and, once it is whole, which video or reference it has become.

    If the service has keys, a request by a link is not told which.
    """
    return opened.body()


@open_router.head("/{upload_id}", include_in_schema=False)
async def get_upload_offset(request: Request, opened: UploadDep) -> Response:
    """Where to go on (tus)."""
    tus.check_version(request.headers)
    upload = opened.upload
    headers = opened.progress() | {"Cache-Control": "no-store"}
    if upload.size_bytes is not None:
        headers["Upload-Length"] = str(upload.size_bytes)
    if upload.said:
        headers["Upload-Metadata"] = upload.said
    return Response(headers=headers)


@open_router.patch(
    "/{upload_id}",
    status_code=204,
    responses=problems(400, 403, 404, 409, 410, 412, 413, 415, 460, 507),
    openapi_extra=_PIECE,
)
async def append_to_upload(request: Request, opened: UploadDep, services: ServicesDep) -> Response:
    """Send the bytes of a file from Upload-Offset on (tus). The last ones make it a video or a reference.

    The answer has its id in `Pvg-Media`, but if the service has keys not in the answer to a request by a link.
    """
    tus.check_version(request.headers)
    tus.check_content_type(request.headers)
    offset, checksum = tus.number(request.headers, "Upload-Offset"), tus.checksum(request.headers)
    now = await pieces.append(services, request, opened.upload, offset, checksum, by_link=opened.by_link)
    return Response(status_code=204, headers=opened.progress(now))


@open_router.delete("/{upload_id}", status_code=204, responses=problems(403, 404, 410, 412, 507))
async def delete_upload(request: Request, opened: UploadDep, services: ServicesDep) -> Response:
    """Delete an upload with what has arrived (tus termination). A video or reference that it has become stays."""
    if "tus-resumable" in request.headers:
        tus.check_version(request.headers)
    await resuming.remove(services, opened.upload.id)
    return Response(status_code=204)


@open_router.put(
    "/{upload_id}",
    responses=problems(400, 403, 404, 409, 410, 413, 415, 507),
    openapi_extra=file_body("The file"),
)
async def send_upload(request: Request, opened: UploadDep, services: ServicesDep) -> UploadBody:
    """Send a whole file as the body, for an upload that has not begun. The same file may be sent again."""
    return await _whole(services, request, opened)


@open_router.post(
    "/{upload_id}",
    response_model=UploadBody,
    responses=_ALSO | problems(400, 403, 404, 409, 410, 412, 413, 415, 460, 507),
    openapi_extra={**fields("X-HTTP-Method-Override"), **file_form("The file as a form")},
)
async def send_upload_as_form(request: Request, opened: UploadDep, services: ServicesDep) -> Response:
    """Send a whole file as the field `file` of a form, or begin it in pieces at a link (tus creation).

    With X-HTTP-Method-Override this is PATCH, DELETE or HEAD of tus, for clients that can send only POST.
    """
    override = request.headers.get("x-http-method-override", "").upper()
    if override in {"PATCH", "DELETE", "HEAD"}:
        if override == "PATCH":
            return await append_to_upload(request, opened, services)
        return await (
            delete_upload(request, opened, services) if override == "DELETE" else get_upload_offset(request, opened)
        )
    if "tus-resumable" in request.headers:
        return await _begin(request, opened, services)
    if media_type(request) != "multipart/form-data":
        raise UnsupportedMediaError("send the file as the field `file` of a form, by PUT as the body, or by tus")
    return Response((await _whole(services, request, opened)).model_dump_json(), media_type="application/json")


async def _begin(request: Request, opened: _Opened, services: Services) -> Response:
    upload = opened.upload
    tus.check_version(request.headers)
    size_bytes, said, raw = _announced(request)
    resuming.check_size(size_bytes, upload.limit_bytes)
    services.room.require(size_bytes)
    await services.calls.write(resuming.begin, services, upload.id, size_bytes, said, raw)
    query = f"?{request.url.query}" if request.url.query else ""
    headers = opened.progress() | {"Location": addresses.of_upload(services.settings, upload.id) + query}
    return Response(status_code=201, headers=headers)


async def _whole(services: Services, request: Request, opened: _Opened) -> UploadBody:
    upload = opened.upload
    # what was sent before may be sent again: the answer may have been lost
    declared = request.headers.get("content-length", "")
    is_other = media_type(request) != "multipart/form-data" and declared not in {"", str(upload.size_bytes)}
    if upload.size_bytes is not None and (upload.media_id is None or is_other):
        raise ConflictError(f"{upload.id} has begun in pieces, or is complete")
    if upload.media_id is None:
        await services.calls.write(resuming.keep, services, upload.id)
    limit_bytes = upload.limit_bytes
    async with (
        services.arriving.place(upload.owner, free=None if upload.media_id is None else upload.id) as share,
        Intake(services.storage.spool, services.room, request, limit_bytes=limit_bytes, share=share) as intake,
    ):
        if media_type(request) == "multipart/form-data":
            form = await read_form(intake, text=False)
            if [name for name, _ in form.files] != ["file"]:
                raise BadRequestError("the form must hold one file, in the field `file`, and nothing else")
            received = form.files[0][1]
        else:
            received = await intake.raw()
        media_id = upload.media_id
        if media_id is None:
            try:
                await resuming.record(services, upload, received, by_link=opened.by_link)
            except ConflictError:
                # the same file may have come by another request meanwhile
                media_id = (await services.calls.read(resuming.find, services, upload.id)).media_id
                if media_id is None:
                    raise
        if media_id is not None and not await services.calls.read(_is_of, services, media_id, received.sha256):
            raise ConflictError(f"{upload.id} is complete, with another file")
    return opened.body(await services.calls.read(resuming.find, services, upload.id))


def _is_of(services: Services, media_id: str, sha256: str) -> bool:
    with services.database.read() as session:
        found = media.get(session, media_id)
    return found is not None and found.sha256 == sha256
