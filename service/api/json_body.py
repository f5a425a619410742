"""Bodies of JSON, read whole: bounded, checked against their Repr-Digest, and validated."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import from_json
from starlette.requests import Request

from service.api.draining import note_limit
from service.api.problems import invalid
from service.api.uploads import check_coding, check_digest, expected_digest
from service.errors import BadRequestError, TooLargeError, UnsupportedMediaError

Model = TypeVar("Model", bound=BaseModel)


def media_type(request: Request) -> str:
    """The declared media type of the body, in lower case, without parameters; empty when there is none."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def has_body(request: Request) -> bool:
    """False when nothing follows the head of a request, as it says itself (RFC 9112, 6.3)."""
    return "transfer-encoding" in request.headers or int(request.headers.get("content-length", "0")) > 0


def unsupported(request: Request, *taken: str) -> UnsupportedMediaError:
    """The error for a body of another type than those that are taken."""
    sent = media_type(request)
    return UnsupportedMediaError(
        f"send this as {' or '.join(taken)}; it {f'came as {sent}' if sent else 'has no type'}"
    )


async def read_json(request: Request, model: type[Model], *, limit_bytes: int, also: Sequence[str] = ()) -> Model:
    """The body of a request, validated. ``also`` are the other types that its address takes.

    Raises `UnsupportedMediaError` for another type or a compressed body, `TooLargeError`, `BadRequestError` for what is
    no JSON or not what its digest says, and `ValidationFailedError`.
    """
    if media_type(request) != "application/json":
        raise unsupported(request, "application/json", *also)
    check_coding(request)
    expected = expected_digest(request.headers.getlist("repr-digest"))
    body = await _body(request, limit_bytes=limit_bytes)
    check_digest(expected, hashlib.sha256(body).hexdigest())
    try:
        from_json(body, allow_inf_nan=False)  # pydantic's models take NaN and Infinity, which JSON has not
    except ValueError as error:
        raise BadRequestError("the body is not valid JSON") from error
    try:
        # JSON has numbers and booleans of its own: a text or a boolean is no number there
        return model.model_validate_json(body, strict=True)
    except ValidationError as error:
        raise invalid(error) from error


async def _body(request: Request, *, limit_bytes: int) -> bytes:
    note_limit(request, limit_bytes)
    too_large = TooLargeError(f"the body is larger than {limit_bytes} bytes", limit_bytes=limit_bytes)
    if int(request.headers.get("content-length", "0")) > limit_bytes:
        raise too_large
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit_bytes:
            raise too_large
    return bytes(body)
