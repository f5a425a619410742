"""Files that arrive in pieces: each piece becomes a blob, and the last one makes them a medium."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Final

from pydantic import ValidationError
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from service import addresses
from service.api import quotas
from service.api.commands.asked import Asked
from service.api.commands.registering import register
from service.api.connections import unread
from service.api.idempotency import Once
from service.api.metadata import to_metadata
from service.api.problems import invalid, invalid_values
from service.api.receivers import receiver_of_fields
from service.api.schemas import OpenUploadBody, ReferenceOptions, UploadBody, UploadPage, VectorBody, VideoOptions
from service.api.services import Services
from service.api.storing import store
from service.api.tus import Checksum
from service.api.uploads import FileSink, Intake, ReceivedFile, clean_name
from service.catalog import ResumableUpload, Role, UploadPart, VectorSettings, amounts, resumable, vector_settings
from service.catalog.retention import is_kept
from service.errors import (
    ChecksumError,
    ConflictError,
    GoneError,
    NotFoundError,
    StoppingError,
    TooLargeError,
    UnsupportedMediaError,
)
from service.storage import CHUNK_BYTES, BlobMissingError

#: a request's bytes are kept in blobs of this size as they come, so that no more of them is lost with its API
PART_BYTES: Final = 64 * 1024**2
#: of one file
MAX_PARTS: Final = 10_000
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


async def append(
    services: Services,
    request: Request,
    upload: ResumableUpload,
    offset: int,
    checksum: Checksum | None,
    *,
    by_link: bool,
) -> ResumableUpload:
    """Take the bytes that begin at ``offset``, by a link to the upload or not. Returns the upload as it then is.

    When the connection breaks or the server stops, what has come is kept, unless it has a checksum. Raises
    `ConflictError` when others are expected, `ChecksumError`, `TooLargeError`, and for the last bytes all that an
    upload raises: of a file that can never become a medium nothing is kept.
    """
    if upload.size_bytes is None or offset != upload.offset_bytes:
        raise ConflictError(f"the next byte is {upload.offset_bytes}, not {offset}")
    left = upload.size_bytes - offset
    now, ttl_s = services.database.now(), services.settings.upload_ttl_s
    if left and not is_kept(upload.expires_at, now=now, ttl_s=ttl_s):
        await services.calls.write(keep, services, upload.id)
    async with (
        services.arriving.place(upload.owner, free=upload.id) as share,  # its size was counted when it was announced
        Intake(services.storage.spool, services.room, request, limit_bytes=left, share=share) as intake,
    ):
        with _no_more_than(upload.size_bytes):
            await intake.expect(left)
        piece = _Piece(services, intake, upload, checksum, by_link=by_link)
        try:
            with _no_more_than(upload.size_bytes):
                async for chunk in request.stream():
                    await piece.feed(chunk)
        except (ClientDisconnect, StoppingError):
            if checksum is None:
                with _no_more_than(upload.size_bytes):
                    await piece.feed(unread(request.scope["state"]))
                await piece.keep()
            raise
        await piece.keep()
    return await services.calls.read(find, services, upload.id)


@contextmanager
def _no_more_than(size_bytes: int) -> Iterator[None]:
    """Inside the block what is over the limit is what is over the length that was announced of the whole file."""
    try:
        yield
    except TooLargeError as error:
        detail = f"more bytes came than the {size_bytes} that Upload-Length announced"
        raise TooLargeError(detail, limit_bytes=size_bytes) from error


class _Piece:
    """The body of one request, as it comes."""

    def __init__(
        self,
        services: Services,
        intake: Intake,
        upload: ResumableUpload,
        checksum: Checksum | None,
        *,
        by_link: bool,
    ) -> None:
        self._services = services
        self._intake = intake
        self._upload = upload
        self._checksum = checksum
        self._by_link = by_link
        self._start = upload.offset_bytes
        self._size = upload.size_bytes or 0
        self._sink = self._open(None)

    def _open(self, size_bytes: int | None) -> FileSink:
        return self._intake.open(
            self._upload.filename,
            size_bytes=size_bytes,
            limit_bytes=self._size - self._start,
            # with a checksum, what the bytes show may be damage
            checks_head=self._start == 0 and self._checksum is None,
        )

    async def feed(self, chunk: bytes) -> None:
        self._sink.feed(chunk)
        async with self._removed_if_of_no_type():
            await self._sink.drain()
        if self._checksum is None and self._sink.size_bytes >= PART_BYTES:
            await self.keep()
            self._sink = self._open(0)

    async def keep(self) -> None:
        """Record what has come since the last call."""
        sink = self._sink
        if not sink.size_bytes:
            return
        async with self._removed_if_of_no_type():
            await sink.complete()
            if self._checksum is not None:
                await run_in_threadpool(_check, sink.path, self._checksum)
            if self._start == 0:
                sink.check_head()
        if self._start + sink.size_bytes == self._size:
            await self._finish(sink)
        else:
            await _keep_part(self._services, self._upload, self._start, sink)
            self._intake.drop(sink)
        self._start += sink.size_bytes

    @asynccontextmanager
    async def _removed_if_of_no_type(self) -> AsyncIterator[None]:
        """A file of no allowed type need not come any further: unless others went on meanwhile, its upload goes."""
        try:
            yield
        except UnsupportedMediaError:
            await remove(self._services, self._upload.id, at=self._start)
            raise

    async def _finish(self, last: FileSink) -> None:
        async with self._removed_if_of_no_type():
            file = await last.finish() if self._start == 0 else await self._joined(last)
        await record(self._services, self._upload, file, by_link=self._by_link)

    async def _joined(self, last: FileSink) -> ReceivedFile:
        whole = self._intake.open(self._upload.filename, size_bytes=self._size, limit_bytes=self._size)
        try:
            for part in await self._before():
                async for chunk in await self._services.storage.stream(part.blob_key, 0, part.size_bytes):
                    whole.feed(chunk)
                    await whole.drain()
        except BlobMissingError as error:
            await self._before()  # unless they are a medium meanwhile
            raise GoneError(f"what had arrived of {self._upload.id} is lost; begin again") from error
        with last.path.open("rb") as file:
            while chunk := await run_in_threadpool(file.read, CHUNK_BYTES):
                whole.feed(chunk)
                await whole.drain()
        return await whole.finish()

    async def _before(self) -> list[UploadPart]:
        """All that comes before this piece. Raises `ConflictError` when another request went on there, or ended it."""
        found = await self._services.calls.read(_parts, self._services, self._upload.id)
        if sum(part.size_bytes for part in found) != self._start:
            raise _taken(self._upload.id)
        return found


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
            raise _taken(upload_id)
        return resumable.remove(session, upload, now=now)


def _parts(services: Services, upload_id: str) -> list[UploadPart]:
    with services.database.read() as session:
        return resumable.parts(session, upload_id)


async def _keep_part(services: Services, upload: ResumableUpload, start: int, sink: FileSink) -> None:
    """Store the bytes of a sink and record them."""
    await services.calls.read(_check_room, services, upload, sink.size_bytes)
    key = services.storage.key("part", sink.sha256, f"{upload.id}-{secrets.token_hex(8)}", "")
    await store(services, sink.path, key, partial(_record_part, services, upload.id, start, sink.size_bytes, key))


def _check_room(services: Services, upload: ResumableUpload, size_bytes: int) -> None:
    """Raise `ConflictError` for one piece too many, `QuotaExceededError` for a small one that takes more than is left.

    The bytes of an upload are counted already; what a piece takes beyond its own is not.
    """
    with services.database.read() as session:
        if resumable.count(session, upload.id) >= MAX_PARTS:
            raise ConflictError(
                f"{upload.id} has {MAX_PARTS} pieces, the most there may be; begin again with larger ones"
            )
        if (more := amounts.PIECE_BYTES - size_bytes) > 0:
            quotas.check(session, upload.owner, now=services.database.now(), jobs=0, size_bytes=more, lock=False)


def _record_part(services: Services, upload_id: str, start: int, size_bytes: int, key: str) -> tuple[None, bool]:
    with services.database.write() as session:
        kept = resumable.append(
            session,
            upload_id,
            start=start,
            size_bytes=size_bytes,
            blob_key=key,
            now=services.database.now(),
            ttl_s=services.settings.upload_ttl_s,
        )
        if not kept:
            raise _taken(upload_id)
    return None, True


def _taken(upload_id: str) -> ConflictError:
    return ConflictError(f"other bytes of {upload_id} came first; ask for its Upload-Offset")


def _check(path: Path, expected: Checksum) -> None:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, expected.algorithm).digest()
    if not hmac.compare_digest(digest, expected.digest):
        raise ChecksumError("the bytes are not those of the Upload-Checksum; send them again")
