"""Files as answers, whole or in ranges. Their ETag is the hash of their content, so that ranges and caches are safe."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from typing import Annotated, Any, Final
from urllib.parse import quote

from fastapi import Depends, Header, Request, Response
from starlette.responses import StreamingResponse

from service.api.dependencies import IfMatch, IfNoneMatch, Responses, all_lines
from service.api.openapi import file_content
from service.api.ranges import matches, parse_range, require_match
from service.api.services import Services
from service.errors import GoneError
from service.storage import BlobMissingError

CLIPS: Final = ("video/mp4", "video/quicktime", "video/x-matroska", "video/webm")
PICTURES: Final = ("image/png", "image/jpeg", "image/webp", "image/tiff")

#: of a name what is not ASCII, ends its quotes or is read as an escape, and what begins a name in UTF-8
_NOT_PLAIN: Final = re.compile(r"""[^ -~]|["%'*\\]""")


def file_answers(*content_types: str) -> Responses:
    """The documentation of a file, whole or in part."""
    whole: dict[str, Any] = {"description": "the file", "content": file_content(*content_types)}
    return {200: whole, 206: {**whole, "description": "the requested range"}, 304: {"description": "unchanged"}}


class BytesAsked:
    """Which bytes of a file a request wants, and on what conditions."""

    def __init__(
        self,
        request: Request,
        _: Annotated[str | None, Header(alias="Range", description="`bytes=0-99999`: one range of the file")] = None,
        if_range: Annotated[
            str | None, Header(description="ETag that the range is of; if the file has another, all of it is sent")
        ] = None,
        if_match: IfMatch = None,
        if_none_match: IfNoneMatch = None,
    ) -> None:
        self.head_only = request.method == "HEAD"
        self.state = request.scope["state"]
        self.range, self.if_range = all_lines(request, "range"), if_range
        self.if_match, self.if_none_match = if_match, if_none_match


BytesAskedDep = Annotated[BytesAsked, Depends()]


@dataclass(frozen=True)
class File:
    """A file in the storage under ``key``; ``of`` is the id of what it belongs to."""

    key: str
    sha256: str
    size_bytes: int
    content_type: str
    filename: str
    of: str


def disposition(filename: str) -> str:
    """What an answer calls its file (RFC 6266, 4.3): for old clients in ASCII, without what they take for an escape."""
    plain = _NOT_PLAIN.sub("_", filename)
    return f"inline; filename=\"{plain}\"; filename*=UTF-8''{quote(filename, safe='')}"


def etag_of_file(sha256: str) -> str:
    """The strong ETag of a file."""
    return f'"{sha256}"'


async def send_file(services: Services, asked: BytesAsked, file: File, *, may_keep: bool = True) -> Response:
    """The bytes that are asked for, or 304; unless the client ``may_keep`` them, for this time alone.

    Raises `PreconditionError`, `RangeError`, and `GoneError` when the storage has none of it.
    """
    etag = etag_of_file(file.sha256)
    require_match(asked.if_match, etag)
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache" if may_keep else "no-store",
        "Repr-Digest": f"sha-256=:{base64.b64encode(bytes.fromhex(file.sha256)).decode()}:",
    }
    if matches(asked.if_none_match, etag):
        return Response(status_code=304, headers=headers)
    wants_range = asked.if_range is None or matches(asked.if_range, etag, weak=False)
    # of HEAD a range means nothing (RFC 9110, 14.2)
    part = parse_range(asked.range, file.size_bytes) if wants_range and not asked.head_only else None
    start, end = part or (0, file.size_bytes)
    headers["Content-Type"] = file.content_type
    headers["Content-Length"] = str(end - start)
    headers["Content-Disposition"] = disposition(file.filename)
    if part:
        headers["Content-Range"] = f"bytes {start}-{end - 1}/{file.size_bytes}"
    status = 206 if part else 200
    removed = GoneError(f"the file of {file.of} has been removed")
    if asked.head_only:
        if not await services.calls.read(services.storage.exists, file.key):
            raise removed
        return Response(status_code=status, headers=headers)
    try:
        pieces = await services.storage.stream(file.key, start, end)
    except BlobMissingError as error:
        raise removed from error
    return StreamingResponse(pieces, status_code=status, headers=headers)
