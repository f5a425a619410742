"""Files as they arrive: streamed to disk, counted and hashed on the way, never whole in memory."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Self
from urllib.parse import unquote

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from service.api.arriving import Share
from service.api.draining import note_limit
from service.api.sniffing import FORMATS, HEAD_BYTES, sniff
from service.catalog import FileType
from service.egress import Egress
from service.errors import BadRequestError, TooLargeError, UnsupportedMediaError
from service.room import Room
from service.spool import Spool

#: bytes collected before they go to the disk and the hash, in a thread
BUFFER_BYTES = 1024**2
#: of a form, what it may be longer by than the files in it
_FORM_BYTES = 64 * 1024
# one member of a dictionary whose values are byte sequences; parameters say nothing here
_DIGEST = re.compile(r"([a-z*][a-z0-9_.*-]*)=:([A-Za-z0-9+/=]*):(?:[ \t]*;[ \t]*[a-z*][a-z0-9_.*-]*(?:=[^,;\" \t]*)?)*")
_NAME_IN_UTF8 = re.compile(r";\s*filename\*\s*=\s*utf-8'[^']*'([^;\s]+)", re.IGNORECASE)
_NAME = re.compile(r';\s*filename\s*=\s*(?:"((?:[^"\\]|\\.)*)"|([^;"\s]+))', re.IGNORECASE)


@dataclass(frozen=True)
class ReceivedFile:
    """A complete upload in a draft file."""

    path: Path
    sha256: str
    size_bytes: int
    kind: FileType
    filename: str | None


class FileSink:
    """One file being received.

    With ``checks_head`` it is refused as soon as its first bytes show that it is of no allowed type.
    """

    def __init__(
        self,
        path: Path,
        file: IO[bytes],
        room: Room,
        share: Share | None,
        limit_bytes: int,
        filename: str | None,
        *,
        checks_head: bool,
    ) -> None:
        self.path = path
        self._checks_head = checks_head
        self._room = room
        self._share = share
        self._counted = 0
        self.filename = filename
        self.size_bytes = 0
        self._limit = limit_bytes
        self._hash = hashlib.sha256()
        self._head = b""
        self._buffer = bytearray()
        self._file = file

    def feed(self, data: bytes) -> None:
        """Take bytes in. Raises `TooLargeError` as soon as there are too many."""
        self.size_bytes += len(data)
        if self.size_bytes > self._limit:
            raise TooLargeError(f"the file is larger than {self._limit} bytes", limit_bytes=self._limit)
        if len(self._head) < HEAD_BYTES:
            self._head = (self._head + data)[:HEAD_BYTES]
        self._buffer += data

    async def drain(self, *, everything: bool = False) -> None:
        """Write what has been collected, when it is worth a write.

        Raises `StorageFullError` when there is no room, `QuotaExceededError` when it is too much for its owner, and
        `UnsupportedMediaError` when the first bytes say so.
        """
        if self._checks_head:
            self.check_head()
        if self._share is not None and (new := self.size_bytes - self._counted):
            self._counted += new
            await self._share.take(new)
        if self._buffer and (everything or len(self._buffer) >= BUFFER_BYTES):
            self._room.take(len(self._buffer))
            data, self._buffer = bytes(self._buffer), bytearray()
            await run_in_threadpool(self._write, data)

    def _write(self, data: bytes) -> None:
        self._hash.update(data)
        self._file.write(data)

    async def complete(self) -> None:
        """Write all of it, whatever it is. It stays open until it is given up: nobody takes it for an abandoned one."""
        await self.drain(everything=True)
        await run_in_threadpool(self._file.flush)

    @property
    def sha256(self) -> str:
        """The hash, as hex, of what has been written."""
        return self._hash.hexdigest()

    async def finish(self) -> ReceivedFile:
        """The whole file. Raises `UnsupportedMediaError` when its bytes are not of an allowed type."""
        await self.complete()
        kind = sniff(self._head)
        if kind is None:
            raise self._of_no_type()
        return ReceivedFile(self.path, self.sha256, self.size_bytes, kind, self.filename)

    def check_head(self) -> None:
        """Raise `UnsupportedMediaError` when what has come already shows that the file is of no allowed type."""
        if len(self._head) == HEAD_BYTES and sniff(self._head) is None:
            raise self._of_no_type()

    def _of_no_type(self) -> UnsupportedMediaError:
        what = "is empty" if not self.size_bytes else "is not a video or image of an allowed type"
        return UnsupportedMediaError(f"the file {what}; allowed are {', '.join(FORMATS[:-1])} and {FORMATS[-1]}")

    def drop(self) -> None:
        """Give the file up: unless it was published, its bytes go."""
        self.path.unlink(missing_ok=True)
        with suppress(OSError):  # what is still to be written has no room
            self._file.close()


class Intake:
    """The files of one request, each of at most ``limit_bytes``. Leaving the block removes every unpublished draft.

    Their bytes count in ``share``, if there is one.
    """

    def __init__(
        self, spool: Spool, room: Room, request: Request, *, limit_bytes: int, share: Share | None = None
    ) -> None:
        self._spool = spool
        self._room = room
        self._share = share
        self.request = request
        self.limit_bytes = limit_bytes
        self._sinks: list[FileSink] = []

    async def __aenter__(self) -> Self:
        """Begin. Raises `UnsupportedMediaError` when the body is compressed."""
        check_coding(self.request)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for sink in self._sinks:
            sink.drop()

    def open(
        self,
        filename: str | None,
        *,
        size_bytes: int | None = None,
        limit_bytes: int | None = None,
        checks_head: bool = True,
    ) -> FileSink:
        """Begin a file, of so many bytes if that is known, else of the body's size at most, and under the limit.

        ``checks_head`` is for bytes that are the beginning of a file; see `FileSink`.

        Raises `StorageFullError` when there is too little room.
        """
        if size_bytes is None:
            size_bytes = self._declared_bytes or 0
        self._room.require(size_bytes)
        limit = self.limit_bytes if limit_bytes is None else limit_bytes
        draft, file = self._spool.new_draft()
        sink = FileSink(draft, file, self._room, self._share, limit, clean_name(filename), checks_head=checks_head)
        self._sinks.append(sink)
        return sink

    def drop(self, sink: FileSink) -> None:
        """Give one of the files up before the block is left: it holds no descriptor and no room any more."""
        self._sinks.remove(sink)
        sink.drop()

    async def raw(self) -> ReceivedFile:
        """Receive a body that is the file itself.

        Raises `TooLargeError`, `UnsupportedMediaError`, and `BadRequestError` when its Repr-Digest does not fit.
        """
        expected = expected_digest(self.request.headers.getlist("repr-digest"))
        await self.expect(self.limit_bytes)
        sink = self.open(declared_name(self.request.headers.get("content-disposition")))
        async for chunk in self.request.stream():
            sink.feed(chunk)
            await sink.drain()
        received = await sink.finish()
        check_digest(expected, received.sha256)
        return received

    async def fetch(self, egress: Egress, url: str, *, owner: str) -> ReceivedFile:
        """Receive the file that is at a URL, under the name that the URL has for it.

        Raises `UrlNotAllowedError`, `FetchFailedError`, `TooLargeError` and `UnsupportedMediaError`.
        """
        name = unquote(egress.check(url).raw_path.decode().partition("?")[0].rsplit("/", 1)[-1])
        async with egress.stream(url, owner=owner) as file:
            size_bytes = file.size_bytes or 0
            if size_bytes > self.limit_bytes:
                raise TooLargeError(f"the file is larger than {self.limit_bytes} bytes", limit_bytes=self.limit_bytes)
            if self._share is not None:
                await self._share.reserve(size_bytes)
            sink = self.open(name, size_bytes=size_bytes)
            async for chunk in file.chunks:
                sink.feed(chunk)
                await sink.drain()
        return await sink.finish()

    async def expect(self, limit: int, *, framing: int = 0) -> None:
        """Look at how many bytes the head declares, before any of them is read: they count from now on.

        Of a form, ``framing`` is what may be around its files. Raises `TooLargeError`, with the limit of a file, when
        they are more than ``limit``, and else `QuotaExceededError` when they are too many for their owner: what is too
        large now will be so at any time.
        """
        note_limit(self.request, limit)
        declared = self._declared_bytes or 0
        if declared > limit + framing:
            raise TooLargeError(f"the file is larger than {self.limit_bytes} bytes", limit_bytes=self.limit_bytes)
        if self._share is not None:
            await self._share.reserve(max(0, declared - _FORM_BYTES) if framing else declared)

    @property
    def _declared_bytes(self) -> int | None:
        """How many bytes the body says that it has; a number of more than 20 digits is refused with the head."""
        declared = self.request.headers.get("content-length", "")
        return int(declared) if declared.isdecimal() else None


def declared_name(disposition: str | None) -> str | None:
    """What a Content-Disposition (RFC 6266, 4.3) calls the body: its `filename*` in UTF-8, else its `filename`."""
    with suppress(UnicodeError):  # fields are read as Latin-1; what clients have beyond ASCII they send as UTF-8
        disposition = disposition and disposition.encode("latin-1").decode()
    if found := _NAME_IN_UTF8.search(disposition or ""):
        return unquote(found[1])
    if found := _NAME.search(disposition or ""):
        return re.sub(r"\\(.)", r"\1", found[1]) if found[1] is not None else found[2]
    return None


def clean_name(filename: str | None) -> str | None:
    """A file name fit to be shown: no folders, no control characters, at most 200 characters."""
    if not filename:
        return None
    name = re.split(r"[/\\]", filename)[-1]
    name = "".join(character for character in name if character.isprintable()).strip()
    return name[-200:] or None


def check_coding(request: Request) -> None:
    """Raise `UnsupportedMediaError` for a body that is compressed: its bytes are taken as they come."""
    named = ",".join(request.headers.getlist("content-encoding")).split(",")
    codings = sorted({coding for one in named if (coding := one.strip().lower()) not in {"", "identity"}})
    if codings:
        raise UnsupportedMediaError(
            f"send the body as it is: its Content-Encoding is {', '.join(codings)}, and none is taken",
            headers={"Accept-Encoding": "identity"},
        )


def expected_digest(lines: Sequence[str]) -> str | None:
    """The sha256, as hex, that Repr-Digest headers (RFC 9530, 3) ask for; None when they name none.

    Other algorithms are passed over, as a receiver may. Raises `BadRequestError` for what is no dictionary of byte
    sequences (RFC 9651, 3.2), and for a sha-256 of another length.
    """
    if not lines:
        return None
    found: dict[str, bytes] = {}
    for member in ",".join(lines).split(","):
        parts = _DIGEST.fullmatch(member.strip(" \t"))
        try:
            if parts is None:
                raise ValueError
            found[parts[1]] = base64.b64decode(parts[2], validate=True)
        except ValueError as error:
            raise BadRequestError("the Repr-Digest header is malformed; it looks like sha-256=:BASE64:") from error
    digest = found.get("sha-256")
    if digest is not None and len(digest) != hashlib.sha256().digest_size:
        raise BadRequestError("the sha-256 of the Repr-Digest header has not 32 bytes")
    return digest.hex() if digest is not None else None


def check_digest(expected: str | None, sha256: str) -> None:
    """Raise `BadRequestError` when what arrived is not what its sender says it is."""
    if expected not in {None, sha256}:
        raise BadRequestError("the body is not what its Repr-Digest says; it was damaged on the way")
