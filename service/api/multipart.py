"""Forms as they arrive (multipart/form-data, RFC 7578): fields kept, files streamed to disk."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header

from service.api.problems import file_at, invalid_values, pointer
from service.api.uploads import FileSink, Intake, ReceivedFile
from service.errors import BadRequestError, TooLargeError

MAX_PARTS = 64
#: of all text fields together, with their names: these are kept in memory
MAX_TEXT_BYTES = 64 * 1024
#: of a part's header: lines, and bytes of one
MAX_HEADERS = 8
MAX_HEADER_BYTES = 8 * 1024
#: what the frame of a multipart body may add to the files
MAX_FRAMING_BYTES = 256 * 1024
#: what may stand before its first part and after its last one, which nobody reads
MAX_OUTSIDE_BYTES = 64 * 1024
#: for who has left the sign out
CURL_SENDS_FILES: Final = "curl sends a file if an @ stands before its path"


@dataclass
class Form:
    """A multipart body: text fields in order, and files by field name."""

    fields: list[tuple[str, str]] = field(default_factory=list)
    files: list[tuple[str, ReceivedFile]] = field(default_factory=list)
    #: of each part, in their order, whether it is a file
    order: list[bool] = field(default_factory=list)

    def parts(self) -> Iterator[tuple[str, str | ReceivedFile]]:
        """Fields and files in the order in which they came."""
        fields, files = iter(self.fields), iter(self.files)
        for is_file in self.order:
            yield next(files) if is_file else next(fields)


class TooManyFilesError(BadRequestError):
    """The form has more files than are taken of it."""


def _anywhere(_name: str) -> str:
    return ""


async def read_form(
    intake: Intake, *, max_files: int = 1, text: bool = True, wrong_file: Callable[[str], str] = _anywhere
) -> Form:
    """Receive the request's body as a form. The size limit is each file's own.

    ``wrong_file`` says of the name of a field why it takes no file, or nothing.

    Raises `BadRequestError` for a malformed body and, without ``text``, at the first field that is no file,
    `ValidationFailedError` at the first file where none belongs, `TooManyFilesError` at the first file over
    ``max_files``, `TooLargeError` for a file, text or a body that is over its limit, and `UnsupportedMediaError`
    for a file that is none: those of files have a pointer, which counts those of one name from 0 where there may be
    several files.
    """
    if "repr-digest" in intake.request.headers:
        raise BadRequestError("Repr-Digest is checked when the body is the file itself, not when it is a form")
    # one of its files is over the limit
    await intake.expect(intake.limit_bytes * max_files, framing=MAX_FRAMING_BYTES)
    _, options = parse_options_header(intake.request.headers.get("content-type", ""))
    boundary = options.get(b"boundary", b"")
    if not boundary or len(boundary) > 70:  # RFC 2046, 5.1.1
        raise BadRequestError("the multipart body has no usable boundary")
    reader = _FormReader(intake, boundary, max_files, text=text, wrong_file=wrong_file)
    return await reader.read(intake.request.stream())


class _FormReader:
    """Feeds the parser and turns its callbacks into fields and files."""

    def __init__(
        self, intake: Intake, boundary: bytes, max_files: int, *, text: bool, wrong_file: Callable[[str], str]
    ) -> None:
        self._intake = intake
        self._wrong_file = wrong_file
        self._max_files = max_files
        self._takes_text = text
        self._text_bytes = 0
        self._form = Form()
        self._headers: dict[str, bytes] = {}
        self._header_name = b""
        self._header_value = b""
        self._name = ""
        self._text: bytearray | None = None
        self._sink: FileSink | None = None
        #: the present part's place, as a JSON pointer
        self._place = ""
        self._finished: list[tuple[str, str, FileSink]] = []
        self._names: Counter[str] = Counter()
        self._parts = 0
        self._complete = False
        #: what ends what stands before the first part, and the end of what has come of that: None after it
        self._delimiter = b"\r\n--" + boundary
        self._before: bytes | None = b"\r\n"
        self._read_bytes = self._outside_bytes = 0
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
            max_header_count=MAX_HEADERS,
            max_header_size=MAX_HEADER_BYTES,
        )

    async def read(self, chunks: AsyncIterator[bytes]) -> Form:
        try:
            async for chunk in chunks:
                is_after = self._complete
                self._parser.write(self._of_parts(chunk))
                self._count(len(chunk), is_outside=is_after or not self._parts)
                await self._drain()
        except MultipartParseError as error:
            raise BadRequestError("the multipart body is malformed") from error
        if not self._complete:
            raise BadRequestError("the multipart body ends before its closing boundary")
        return self._form

    def _of_parts(self, chunk: bytes) -> bytes:
        """The chunk without what stands before the first part (RFC 2046, 5.1.1), which the parser does not take."""
        if self._before is None:
            return chunk
        before = self._before + chunk
        at = before.find(self._delimiter)
        if at < 0:
            self._before = before[1 - len(self._delimiter) :]
            return b""
        self._before = None
        return before[at + len(b"\r\n") :]

    def _count(self, size_bytes: int, *, is_outside: bool) -> None:
        """Raise `TooLargeError` when the body is larger than one of its length could be, had it been declared."""
        self._read_bytes += size_bytes
        self._outside_bytes += size_bytes if is_outside else 0
        limit = self._intake.limit_bytes * self._max_files + MAX_FRAMING_BYTES
        if self._read_bytes > limit:
            raise TooLargeError(f"the form is larger than {limit} bytes", limit_bytes=limit)
        if self._outside_bytes > MAX_OUTSIDE_BYTES:
            detail = f"more than {MAX_OUTSIDE_BYTES} bytes stand before the form's first part or after its last one"
            raise TooLargeError(detail, limit_bytes=MAX_OUTSIDE_BYTES)

    async def _drain(self) -> None:
        for name, place, sink in self._finished:
            with file_at(place):
                self._form.files.append((name, await sink.finish()))
        self._finished.clear()
        if self._sink is not None:
            with file_at(self._place):
                await self._sink.drain()

    def _begin(self) -> None:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise BadRequestError(f"the multipart body has more than {MAX_PARTS} parts")
        self._headers.clear()
        self._text = self._sink = None

    def _on_header_name(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]

    def _end_header(self) -> None:
        self._headers[self._header_name.decode("latin-1").lower()] = self._header_value
        self._header_name = self._header_value = b""

    def _end_headers(self) -> None:
        _, options = parse_options_header(self._headers.get("content-disposition", b""))
        if b"name" not in options:
            raise BadRequestError("a part of the multipart body has no name")
        self._name = options[b"name"].decode("utf-8", "replace")
        self._place = pointer((self._name, *([self._names[self._name]] if self._max_files > 1 else [])))
        self._names[self._name] += 1
        # a file may have no name (RFC 7578, 4.2)
        is_file = b"filename" in options or self._is_file()
        self._form.order.append(is_file)
        if not is_file:
            if not self._takes_text:
                raise BadRequestError(f"the form must hold files alone; {self._name!r} is none")
            self._text = bytearray()
            self._count_text(len(options[b"name"]))
            return
        if wrong := self._wrong_file(self._name):
            raise invalid_values({pointer((self._name,)): wrong})
        if len(self._form.files) + len(self._finished) >= self._max_files:
            raise TooManyFilesError(f"the multipart body has more files than the {self._max_files} allowed")
        self._sink = self._intake.open(options.get(b"filename", b"").decode("utf-8", "replace"))

    def _is_file(self) -> bool:
        kind = self._headers.get("content-type", b"").strip().lower()
        return kind.startswith((b"application/octet-stream", b"image/", b"video/"))

    def _on_data(self, data: bytes, start: int, end: int) -> None:
        if self._sink is not None:
            with file_at(self._place):
                self._sink.feed(data[start:end])
        elif self._text is not None:
            self._count_text(end - start)
            self._text += data[start:end]

    def _count_text(self, size_bytes: int) -> None:
        self._text_bytes += size_bytes
        if self._text_bytes > MAX_TEXT_BYTES:
            detail = f"the fields of text up to {self._name!r} have more than {MAX_TEXT_BYTES} bytes with their names"
            detail += "; a file's part has a filename, or a type such as image/jpeg"
            raise TooLargeError(detail, limit_bytes=MAX_TEXT_BYTES)

    def _end(self) -> None:
        if self._sink is not None:
            self._finished.append((self._name, self._place, self._sink))
            self._sink = None
        elif self._text is not None:
            try:
                self._form.fields.append((self._name, self._text.decode()))
            except UnicodeDecodeError as error:
                raise BadRequestError(f"the field {self._name!r} is not UTF-8") from error
            self._text = None

    def _on_end(self) -> None:
        self._complete = True
