"""/results: finished files, whole or in ranges."""

from __future__ import annotations

import base64
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Header, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse

from service.api.dependencies import Responses, ResultId, ServicesDep, problems
from service.api.ranges import matches, parse_range
from service.api.services import Services
from service.catalog import Result, results
from service.errors import GoneError, NotFoundError
from service.storage import BlobMissingError

router = APIRouter(prefix="/results", tags=["results"])

_FILE: dict[str, Any] = {"description": "the file", "content": {"video/mp4": {}, "image/png": {}}}
_RANGE = {**_FILE, "description": "the requested range"}
_RESPONSES: Responses = {200: _FILE, 206: _RANGE, 304: {"description": "unchanged"}}


@router.get("/{result_id}", response_class=StreamingResponse, responses={**_RESPONSES, **problems(404, 410, 416)})
@router.head("/{result_id}", include_in_schema=False)
async def download(
    request: Request,
    result_id: ResultId,
    services: ServicesDep,
    range_: Annotated[str | None, Header(alias="Range")] = None,
    if_range: Annotated[str | None, Header()] = None,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """The file. Its ETag is the sha256 of the content, so ranges and caches are safe."""
    result, key = await run_in_threadpool(_find, services, result_id)
    etag = f'"{result.sha256}"'
    headers = {
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, no-cache",
        "Repr-Digest": f"sha-256=:{base64.b64encode(bytes.fromhex(result.sha256)).decode()}:",
    }
    if matches(if_none_match, etag):
        return Response(status_code=304, headers=headers)
    wants_range = if_range is None or matches(if_range, etag, weak=False)
    asked = parse_range(range_, result.size_bytes) if wants_range else None
    start, end = asked or (0, result.size_bytes)
    headers["Content-Type"] = result.content_type
    headers["Content-Length"] = str(end - start)
    headers["Content-Disposition"] = f"inline; filename*=UTF-8''{quote(result.filename)}"
    if asked:
        headers["Content-Range"] = f"bytes {start}-{end - 1}/{result.size_bytes}"
    status = 206 if asked else 200
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers)
    try:
        pieces = await services.storage.stream(key, start, end)
    except BlobMissingError as error:
        raise GoneError(f"the file of {result_id} has been removed") from error
    return StreamingResponse(pieces, status_code=status, headers=headers)


def _find(services: Services, result_id: str) -> tuple[Result, str]:
    with services.database.read() as session:
        result = results.get(session, result_id)
    if result is None:
        raise NotFoundError(f"there is no result {result_id}")
    if result.blob_key is None or result.expires_at < services.database.now():
        raise GoneError(f"{result_id} has expired; run the transfer again to make it once more")
    return result, result.blob_key
