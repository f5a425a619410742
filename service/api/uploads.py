"""Files as they arrive: streamed to disk, counted and hashed on the way, never whole in memory."""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from service.api.sniffing import HEAD_BYTES, sniff
from service.catalog import FileType
from service.errors import BadRequestError, TooLargeError, UnsupportedMediaError
from service.storage import Storage

#: bytes collected before they go to the disk and the hash, in a thread
BUFFER_BYTES = 1024**2


@dataclass(frozen=True)
class ReceivedFile:
    """A complete upload in a draft file."""

    path: Path
    sha256: str
    size_bytes: int
    kind: FileType
    filename: str | None


class FileSink:
    """One file being received."""

    def __init__(self, path: Path, limit_bytes: int, filename: str | None) -> None:
        self.path = path
        self.filename = filename
        self.size_bytes = 0
        self._limit = limit_bytes
        self._hash = hashlib.sha256()
        self._head = b""
        self._buffer = bytearray()
        self._file: IO[bytes] = path.open("xb")

    def feed(self, data: bytes) -> None:
        """Take bytes in. Raises `TooLargeError` as soon as there are too many."""
        self.size_bytes += len(data)
        if self.size_bytes > self._limit:
            raise TooLargeError(f"the file is larger than {self._limit} bytes")
        if len(self._head) < HEAD_BYTES:
            self._head = (self._head + data)[:HEAD_BYTES]
        self._buffer += data

    async def drain(self, *, everything: bool = False) -> None:
        """Write what has been collected, when it is worth a write."""
        if self._buffer and (everything or len(self._buffer) >= BUFFER_BYTES):
            data, self._buffer = bytes(self._buffer), bytearray()
            await run_in_threadpool(self._write, data)

    def _write(self, data: bytes) -> None:
        self._hash.update(data)
        self._file.write(data)

    async def finish(self) -> ReceivedFile:
        """Close the file. Raises `UnsupportedMediaError` when its bytes are not of an allowed type."""
        await self.drain(everything=True)
        await run_in_threadpool(self._file.close)
        kind = sniff(self._head)
        if kind is None:
            what = "is empty" if not self.size_bytes else "is not a video or image of an allowed type"
            raise UnsupportedMediaError(f"the file {what}; allowed are mp4, mov, webm, mkv, avi, jpeg, png and webp")
        return ReceivedFile(self.path, self._hash.hexdigest(), self.size_bytes, kind, self.filename)

    def close(self) -> None:
        """Give the file up."""
        self._file.close()


class Intake:
    """The files of one request, each of at most ``limit_bytes``. Leaving the block removes every unpublished draft."""

    def __init__(self, storage: Storage, request: Request, *, limit_bytes: int) -> None:
        self._storage = storage
        self.request = request
        self.limit_bytes = limit_bytes
        self._sinks: list[FileSink] = []

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for sink in self._sinks:
            sink.close()
            sink.path.unlink(missing_ok=True)

    def open(self, filename: str | None) -> FileSink:
        """Begin a file."""
        sink = FileSink(self._storage.draft(), self.limit_bytes, clean_name(filename))
        self._sinks.append(sink)
        return sink

    async def raw(self) -> ReceivedFile:
        """Receive a body that is the file itself.

        Raises `TooLargeError`, `UnsupportedMediaError`, and `BadRequestError` when its Repr-Digest does not fit.
        """
        self.check_declared(self.limit_bytes)
        sink = self.open(None)
        async for chunk in self.request.stream():
            sink.feed(chunk)
            await sink.drain()
        received = await sink.finish()
        check_digest(self.request.headers.get("repr-digest"), received.sha256)
        return received

    def check_declared(self, limit: int) -> None:
        """Raise `TooLargeError` when the request declares a body of more than ``limit`` bytes."""
        declared = self.request.headers.get("content-length", "")
        if declared.isdecimal() and int(declared) > limit:
            raise TooLargeError(f"the body is larger than {limit} bytes")


def clean_name(filename: str | None) -> str | None:
    """A file name fit to be shown: no folders, no control characters, at most 200 characters."""
    if not filename:
        return None
    name = re.split(r"[/\\]", filename)[-1]
    name = "".join(character for character in name if character.isprintable()).strip()
    return name[-200:] or None


def check_digest(header: str | None, sha256: str) -> None:
    """Compare a Repr-Digest header (RFC 9530) with what arrived; other algorithms than sha-256 are ignored."""
    found = re.search(r"(?:^|,)\s*sha-256=:([A-Za-z0-9+/=]*):", header or "")
    if not found:
        return
    try:
        expected = base64.b64decode(found[1], validate=True).hex()
    except binascii.Error as error:
        raise BadRequestError("the Repr-Digest header is malformed") from error
    if expected != sha256:
        raise BadRequestError("the body is not what its Repr-Digest says; it was damaged on the way")
