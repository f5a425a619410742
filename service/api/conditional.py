"""Answers of JSON with a strong ETag, and 304 for a client that has it already (RFC 9110, 8.8.3 and 13.1.2)."""

from __future__ import annotations

import hashlib

from pydantic import BaseModel
from starlette.responses import Response

from service.api.ranges import matches


def etag_of(content: bytes) -> str:
    """The strong ETag of JSON, the hash of its bytes."""
    return f'"{hashlib.sha256(content).hexdigest()[:32]}"'


def conditional(if_none_match: str | None, body: BaseModel | bytes, headers: dict[str, str] | None = None) -> Response:
    """A model, or JSON, with the hash of its bytes as its ETag; 304 when that is in the request's If-None-Match."""
    content = body if isinstance(body, bytes) else body.model_dump_json().encode()
    etag = etag_of(content)
    headers = {**(headers or {}), "ETag": etag, "Cache-Control": "private, no-cache"}
    if matches(if_none_match, etag):
        return Response(status_code=304, headers=headers)
    return Response(content, headers=headers, media_type="application/json")
