"""Files that are announced and arrive later, by tus or a link: what is recorded of them. `pieces` takes their bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Final

from pydantic import ValidationError
from sqlalchemy.orm import Session

from service import addresses
from service.api import quotas
from service.api.commands.asked import Asked
from service.api.commands.registering import register
from service.api.idempotency import Once
from service.api.metadata import to_metadata
from service.api.problems import invalid, invalid_values
from service.api.receivers import receiver_of_fields
from service.api.schemas import OpenUploadBody, ReferenceOptions, UploadBody, UploadPage, VectorBody, VideoOptions
from service.api.services import Services
from service.api.uploads import ReceivedFile, clean_name
from service.catalog import ResumableUpload, Role, VectorSettings, resumable, vector_settings
from service.errors import ConflictError, NotFoundError, TooLargeError, UnsupportedMediaError

#: what clients say of a file that its bytes say better
_PASSED_OVER: Final = frozenset({"filename", "name", "filetype", "type", "relativePath"})
#: what is said of an upload besides its settings
_ABOUT: Final = _PASSED_OVER | {"role", "webhook"}
_OWN: Final = "metadata."


def body_of(upload: ResumableUpload) -> UploadBody:
    """The answer that shows an upload."""
    return UploadBody.model_validate(
        {
            "id": upload.id,
            "role": upload.role,
            "filename": upload.filename,
            "size_bytes": upload.size_bytes,
            "offset_bytes": upload.offset_bytes,
            "media": upload.media_id,
            "created_at": upload.created_at,
            "expires_at": upload.expires_at,
        }
    )


def page(services: Services, owner: str, cursor: str | None, limit: int) -> UploadPage:
    """Files of an owner that have not arrived, newest first."""
    with services.database.read() as session:
        now = services.database.now()
        found = resumable.page(session, owner, before=cursor, limit=limit + 1, now=now)
    shown = [_open_body(services, upload) for upload in found[:limit]]
    return UploadPage(data=shown, next_cursor=shown[-1].id if len(found) > limit else None)


def _open_body(services: Services, upload: ResumableUpload) -> OpenUploadBody:
    return OpenUploadBody(
        **body_of(upload).model_dump(),
        url=addresses.of_upload(services.settings, upload.id),
        settings=VectorBody(**asdict(vector_settings(upload))),
        metadata=upload.metadata_,
    )


def name_of(said: Mapping[str, str]) -> str | None:
    """The file's name, by what clients call it."""
    return clean_name(said.get("filename") or said.get("name"))


def check_size(size_bytes: int, limit_bytes: int) -> None:
    """Raise `UnsupportedMediaError` for an empty file and `TooLargeError` for one over the limit."""
    if size_bytes == 0:
        raise UnsupportedMediaError("the file is empty")
    if size_bytes > limit_bytes:
        raise TooLargeError(f"the file is larger than {limit_bytes} bytes", limit_bytes=limit_bytes)


def create(
    services: Services, owner: str, once: Once, size_bytes: int, said: Mapping[str, str], raw: str
) -> UploadBody:
    """Record a file that is to arrive in pieces.

    Raises `QuotaExceededError`, and what `options` and `receiver_of_fields` raise.
    """
    role, settings, metadata = options(said)
    webhook = receiver_of_fields(services, [said["webhook"]] if "webhook" in said else [])
    limit = services.settings.max_upload_bytes
    with services.database.write() as session:
        now = services.database.now()
        quotas.check(session, owner, now=now, size_bytes=size_bytes, uploads=1)
        made = resumable.create(
            session,
            role,
            settings,
            owner=owner,
            limit_bytes=limit,
            now=now,
            ttl_s=services.settings.upload_ttl_s,
            size_bytes=size_bytes,
            filename=name_of(said),
            said=raw,
            metadata=metadata,
            webhook=webhook,
        )
        body = body_of(made)
        once.keep(session, 201, body, location=addresses.of_upload(services.settings, made.id), resource_id=made.id)
    return body


def options(said: Mapping[str, str]) -> tuple[Role, VectorSettings, dict[str, str]]:
    """What Upload-Metadata says of the file: what for, how it is vectorised, and names of its sender's own.

    Raises `ValidationFailedError`.
    """
    role = said.get("role", Role.VIDEO.value)
    if role not in {one.value for one in Role}:
        raise invalid_values({"/role": "Input should be 'video' or 'reference'"})
    own = {name: value for name, value in said.items() if name.startswith(_OWN)}
    given = {name: value for name, value in said.items() if name not in {*_ABOUT, *own}}
    settings = settings_of(Role(role), given)
    return Role(role), settings, to_metadata([f"{name[len(_OWN) :]}:{value}" for name, value in own.items()])


def settings_of(role: Role, given: Mapping[str, str]) -> VectorSettings:
    """How a medium of this role is vectorised. Raises `ValidationFailedError` for what it is not asked for."""
    model = VideoOptions if role is Role.VIDEO else ReferenceOptions
    try:
        return VectorSettings(**model.model_validate(dict(given)).model_dump())
    except ValidationError as error:
        raise invalid(error) from error


async def record(services: Services, upload: ResumableUpload, file: ReceivedFile, *, by_link: bool) -> None:
    """Make a medium of the file, which ends the upload."""
    once = Once(services, upload.owner, None, "")
    metadata = dict(upload.metadata_)
    asked = Asked(upload.owner, once, metadata=metadata, webhook=upload.webhook, upload=upload.id, by_link=by_link)
    await register(services, Role(upload.role), file, vector_settings(upload), asked=asked)


def find(services: Services, upload_id: str, owner: str | None = None) -> ResumableUpload:
    """The upload. Raises `NotFoundError`, with an ``owner`` also for another's."""
    with services.database.read() as session:
        return find_in(session, services, upload_id, owner)


def find_in(session: Session, services: Services, upload_id: str, owner: str | None = None) -> ResumableUpload:
    """The same in an open transaction."""
    found = resumable.get(session, upload_id, owner=owner, now=services.database.now())
    if found is None:
        raise NotFoundError(f"there is no upload {upload_id}, or its time is over")
    return found


def keep(services: Services, upload_id: str) -> None:
    """Have an upload outlive its time, and that of its link, while bytes of the file arrive."""
    with services.database.write() as session:
        resumable.keep(session, upload_id, now=services.database.now(), ttl_s=services.settings.upload_ttl_s)


def begin(services: Services, upload_id: str, size_bytes: int, said: Mapping[str, str], raw: str) -> None:
    """Say the size and the name of the file that comes by a link. What it is for, the link says.

    The same may be said again until some of it is there. Raises `ConflictError` when it has begun otherwise, and
    `QuotaExceededError`.
    """
    with services.database.write() as session:
        now = services.database.now()
        upload = find_in(session, services, upload_id)
        check_size(size_bytes, upload.limit_bytes)
        if upload.size_bytes is None:
            quotas.check(session, upload.owner, now=now, size_bytes=size_bytes)
        begun = resumable.begin(session, upload, size_bytes=size_bytes, filename=name_of(said), said=raw)
        is_same = (upload.size_bytes, upload.said, upload.offset_bytes) == (size_bytes, raw, 0)
        if not begun and not is_same:
            raise ConflictError(f"{upload_id} has begun before; ask for its Upload-Offset")


async def remove(services: Services, upload_id: str, *, at: int | None = None) -> None:
    """Remove an upload with what has arrived of it; a medium that it has become stays.

    Raises `NotFoundError`, and `ConflictError` for one whose offset is not ``at``, if that is given.
    """
    gone = await services.calls.write(_remove, services, upload_id, at)
    await services.calls.remove(services.blobs.delete, gone)


def _remove(services: Services, upload_id: str, at: int | None) -> list[str]:
    with services.database.write(frees=True) as session:
        now = services.database.now()
        upload = resumable.get(session, upload_id, now=now, lock=True)
        if upload is None:
            raise NotFoundError(f"there is no upload {upload_id}, or its time is over")
        if at not in {None, upload.offset_bytes}:
            raise others_came_first(upload_id)
        return resumable.remove(session, upload, now=now)


def others_came_first(upload_id: str) -> ConflictError:
    """The error for bytes, or an end, of an upload that is further than their sender knows."""
    return ConflictError(f"other bytes of {upload_id} came first; ask for its Upload-Offset")
