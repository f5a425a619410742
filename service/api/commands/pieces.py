"""Pieces of files on their way: what comes of each becomes a blob, and the last one makes them a medium."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from pathlib import Path
from typing import Final

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from service.api import quotas
from service.api.commands.resuming import find, keep, others_came_first, record, remove
from service.api.connections import unread
from service.api.services import Services
from service.api.storing import store
from service.api.tus import Checksum
from service.api.uploads import FileSink, Intake, ReceivedFile
from service.catalog import ResumableUpload, UploadPart, amounts, resumable
from service.catalog.retention import is_kept
from service.errors import ChecksumError, ConflictError, GoneError, StoppingError, TooLargeError, UnsupportedMediaError
from service.storage import CHUNK_BYTES, BlobMissingError

#: a request's bytes are kept in blobs of this size as they come, so that no more of them is lost with its API
PART_BYTES: Final = 64 * 1024**2
#: of one file
MAX_PARTS: Final = 10_000


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
            raise others_came_first(self._upload.id)
        return found


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
            raise others_came_first(upload_id)
    return None, True


def _check(path: Path, expected: Checksum) -> None:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, expected.algorithm).digest()
    if not hmac.compare_digest(digest, expected.digest):
        raise ChecksumError("the bytes are not those of the Upload-Checksum; send them again")
