"""Files as they arrive: streamed to disk, counted and hashed on the way, never whole in memory."""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from service.errors import BadRequestError, TooLargeError, UnsupportedMediaError
from service.sniff import HEAD_BYTES, FileType, sniff
from service.storage import Storage

#: bytes collected before they go to the disk and the hash, in a thread
BUFFER_BYTES = 1024**2
MAX_PARTS = 64
MAX_FIELD_BYTES = 64 * 1024
MAX_HEADER_BYTES = 8 * 1024
#: what the frame of a multipart body may add to the files
MAX_FRAMING_BYTES = 256 * 1024


@dataclass(frozen=True)
class ReceivedFile:
    """A complete upload in a draft file."""

    path: Path
    sha256: str
    size_bytes: int
    kind: FileType
    filename: str | None


@dataclass
class Form:
    """A multipart body: text fields in order, and files by field name."""

    fields: list[tuple[str, str]] = field(default_factory=list)
    files: list[tuple[str, ReceivedFile]] = field(default_factory=list)


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
    """The files of one request. Leaving the block removes every draft that was not published."""

    def __init__(self, storage: Storage, request: Request, *, limit_bytes: int) -> None:
        self._storage = storage
        self._request = request
        self._limit = limit_bytes
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
        sink = FileSink(self._storage.draft(), self._limit, clean_name(filename))
        self._sinks.append(sink)
        return sink

    async def raw(self) -> ReceivedFile:
        """Receive a body that is the file itself."""
        self._check_declared(self._limit)
        sink = self.open(None)
        async for chunk in self._request.stream():
            sink.feed(chunk)
            await sink.drain()
        received = await sink.finish()
        check_digest(self._request.headers.get("repr-digest"), received.sha256)
        return received

    async def form(self, *, max_files: int = 1) -> Form:
        """Receive a multipart/form-data body. The size limit is each file's own."""
        self._check_declared(self._limit * max_files + MAX_FRAMING_BYTES)
        _, options = parse_options_header(self._request.headers.get("content-type", ""))
        boundary = options.get(b"boundary", b"")
        if not boundary or len(boundary) > 70:  # RFC 2046, 5.1.1
            raise BadRequestError("the multipart body has no usable boundary")
        return await _FormReader(self, boundary, max_files).read(self._request.stream())

    def _check_declared(self, limit: int) -> None:
        declared = self._request.headers.get("content-length", "")
        if declared.isdecimal() and int(declared) > limit:
            raise TooLargeError(f"the body is larger than {limit} bytes")


class _FormReader:
    """Feeds the parser and turns its callbacks into fields and files."""

    def __init__(self, intake: Intake, boundary: bytes, max_files: int) -> None:
        self._intake = intake
        self._max_files = max_files
        self._form = Form()
        self._headers: dict[str, bytes] = {}
        self._header_name = b""
        self._header_value = b""
        self._name = ""
        self._text: bytearray | None = None
        self._sink: FileSink | None = None
        self._finished: list[tuple[str, FileSink]] = []
        self._parts = 0
        self._complete = False
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin,
                "on_header_field": self._on_header_name,
                "on_header_value": self._on_header_value,
                "on_header_end": self._end_header,
                "on_headers_finished": self._end_headers,
                "on_part_data": self._on_data,
                "on_part_end": self._end,
                "on_end": self._on_end,
            },
        )

    async def read(self, chunks: AsyncIterator[bytes]) -> Form:
        try:
            async for chunk in chunks:
                self._parser.write(chunk)
                await self._drain()
        except MultipartParseError as error:
            raise BadRequestError("the multipart body is malformed") from error
        if not self._complete:
            raise BadRequestError("the multipart body ends before its closing boundary")
        return self._form

    async def _drain(self) -> None:
        for name, sink in self._finished:
            self._form.files.append((name, await sink.finish()))
        self._finished.clear()
        if self._sink is not None:
            await self._sink.drain()

    def _begin(self) -> None:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise BadRequestError(f"the multipart body has more than {MAX_PARTS} parts")
        self._headers.clear()
        self._text = self._sink = None

    def _on_header_name(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]
        self._check_header()

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]
        self._check_header()

    def _check_header(self) -> None:
        if len(self._header_name) + len(self._header_value) > MAX_HEADER_BYTES:
            raise BadRequestError("a part of the multipart body has an oversized header")

    def _end_header(self) -> None:
        self._headers[self._header_name.decode("latin-1").lower()] = self._header_value
        self._header_name = self._header_value = b""

    def _end_headers(self) -> None:
        _, options = parse_options_header(self._headers.get("content-disposition", b""))
        if b"name" not in options:
            raise BadRequestError("a part of the multipart body has no name")
        self._name = options[b"name"].decode("utf-8", "replace")
        if b"filename" not in options:
            self._text = bytearray()
            return
        if len(self._form.files) + len(self._finished) >= self._max_files:
            raise BadRequestError(f"the multipart body has more files than the {self._max_files} allowed")
        self._sink = self._intake.open(options[b"filename"].decode("utf-8", "replace"))

    def _on_data(self, data: bytes, start: int, end: int) -> None:
        if self._sink is not None:
            self._sink.feed(data[start:end])
        elif self._text is not None:
            self._text += data[start:end]
            if len(self._text) > MAX_FIELD_BYTES:
                raise TooLargeError(f"the field {self._name!r} is larger than {MAX_FIELD_BYTES} bytes")

    def _end(self) -> None:
        if self._sink is not None:
            self._finished.append((self._name, self._sink))
            self._sink = None
        elif self._text is not None:
            try:
                self._form.fields.append((self._name, self._text.decode()))
            except UnicodeDecodeError as error:
                raise BadRequestError(f"the field {self._name!r} is not UTF-8") from error
            self._text = None

    def _on_end(self) -> None:
        self._complete = True


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


async def read_json(request: Request, *, limit_bytes: int) -> bytes:
    """A small body, whole. Raises `TooLargeError`."""
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit_bytes:
            raise TooLargeError(f"the body is larger than {limit_bytes} bytes")
    return bytes(body)
