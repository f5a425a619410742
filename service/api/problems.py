"""Every error as application/problem+json."""

from __future__ import annotations

import errno
import re
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from pydantic_core import ErrorDetails
from sqlalchemy.exc import OperationalError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse

from service.errors import (
    PROBLEM_JSON,
    PROBLEMS,
    BadRequestError,
    ProblemType,
    ServiceError,
    StorageFullError,
    UnavailableError,
    ValidationFailedError,
    message_of,
    problem_body,
)

_UNION_MEMBER = re.compile(r"literal\[.*|constrained-\w+|list\[.*|function-\w+.*|MakeupParts")


def problem_response(request: Request, error: ServiceError) -> JSONResponse:
    """The answer for an error."""
    return _respond(request, error.problem(), error.headers)


def _respond(request: Request, body: dict[str, Any], headers: dict[str, str] | None) -> JSONResponse:
    body["instance"] = request.url.path
    body["request_id"] = getattr(request.state, "request_id", "")
    return JSONResponse(body, status_code=body["status"], headers=headers, media_type=PROBLEM_JSON)


def pointer(location: tuple[int | str, ...]) -> str:
    """A JSON pointer (RFC 6901) into the request."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in location)


def invalid(error: ValidationError) -> ServiceError:
    """The problem for a body that pydantic refused."""
    return _from_details(error.errors(include_url=False, include_context=False, include_input=False))


def _from_details(details: list[ErrorDetails]) -> ServiceError:
    if any(item["type"] == "json_invalid" for item in details):
        return BadRequestError("the body is not valid JSON")
    by_pointer: dict[str, list[str]] = {}
    for item in details:
        # pydantic names the members of a union as if they were part of the path
        location = tuple(part for part in item["loc"] if not _UNION_MEMBER.fullmatch(str(part)))
        messages = by_pointer.setdefault(pointer(location), [])
        message = message_of(item)
        if message not in messages:
            messages.append(message)
    # of a list that may also be a word, only what is wrong inside the list is worth saying
    inner = [where for where in by_pointer if not any(other.startswith(f"{where}/") for other in by_pointer)]
    return invalid_values({where: ", or ".join(by_pointer[where]) for where in inner})


def invalid_values(errors: dict[str, str]) -> ServiceError:
    """The problem for values that are not allowed: what is wrong, by JSON pointer."""
    where, detail = next(iter(errors.items()))
    items = [{"pointer": pointer, "detail": text} for pointer, text in errors.items()]
    return ValidationFailedError(f"{where or 'body'}: {detail}", errors=items)


def install(app: FastAPI) -> None:
    """Register the handlers of every error the application raises on purpose or through its framework."""

    @app.exception_handler(ServiceError)
    async def on_service_error(request: Request, error: ServiceError) -> JSONResponse:
        return problem_response(request, error)

    @app.exception_handler(RequestValidationError)
    async def on_invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        return problem_response(request, _from_details(list(error.errors())))

    @app.exception_handler(HTTPException)
    async def on_http_error(request: Request, error: HTTPException) -> JSONResponse:
        phrase = HTTPStatus(error.status_code).phrase
        name = phrase.lower().replace(" ", "-")
        kind = PROBLEMS.get(name) or ProblemType(name, phrase, error.status_code)
        return _respond(request, problem_body(kind, str(error.detail)), dict(error.headers or {}))

    @app.exception_handler(OSError)
    async def on_os_error(request: Request, error: OSError) -> JSONResponse:
        if error.errno in {errno.ENOSPC, errno.EDQUOT}:
            return problem_response(request, StorageFullError("no room is left for this; try again later"))
        raise error

    @app.exception_handler(OperationalError)
    async def on_database_error(request: Request, error: OperationalError) -> JSONResponse:
        if "disk is full" in str(error.orig) or "No space left" in str(error.orig):
            return problem_response(request, StorageFullError("no room is left for this; try again later"))
        if error.connection_invalidated or "locked" in str(error.orig):
            return problem_response(request, UnavailableError("the records cannot be reached; try again"))
        raise error
