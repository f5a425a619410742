"""Every error as application/problem+json."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from itertools import islice
from typing import Any, Final

import structlog
from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from fastapi.routing import iter_route_contexts
from obstore.exceptions import BaseError
from pydantic import ValidationError
from pydantic_core import ErrorDetails
from sqlalchemy.exc import SQLAlchemyError
from starlette._utils import get_route_path
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Match
from starlette.types import Scope

from service.api.schemas import METADATA_NAME, METADATA_PAIR, METADATA_VALUE
from service.errors import (
    PROBLEM_JSON,
    PROBLEMS,
    FetchFailedError,
    ProblemType,
    ServiceError,
    StorageFullError,
    TooLargeError,
    UnavailableError,
    UnsupportedMediaError,
    UrlNotAllowedError,
    ValidationFailedError,
    message_of,
    problem_body,
)
from service.ids import MEDIA_ID
from service.outages import is_disk_full, is_outage

log = structlog.get_logger(__name__)

#: places in a request that an answer names as wrong
MAX_ERRORS: Final = 100
#: as many as pydantic names in some 10 ms
_MOST_DETAILS: Final = 5000
_METHODS: Final = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
#: of a field that nothing here has
NO_FIELD: Final = "there is no such field here"
_OF_PATTERNS: Final = {
    MEDIA_ID.pattern: "this is not the id of a video or a reference",
    METADATA_PAIR: "this is not name:value; a name has up to 40 letters, digits, `_`, `.`, `-`, a value 200 characters",
    f"^{METADATA_NAME}$": "a name has up to 40 letters, digits, `_`, `.`, `-`",
    f"^{METADATA_VALUE}$": "a value has up to 200 characters, and no control characters",
}
#: of any list: some have the ids of what they list
_NO_CURSOR: Final = "this is not the `next_cursor` of a page"
_WORDS: Final = {
    "Extra inputs are not permitted": NO_FIELD,
    **{f"String should match pattern '{pattern}'": words for pattern, words in _OF_PATTERNS.items()},
}
_UNION_MEMBER = re.compile(r"literal\[.*|constrained-\w+|list\[.*|function-\w.*|MakeupParts")


def problem_response(request: Request, error: ServiceError) -> JSONResponse:
    """The answer for an error."""
    return _respond(request, error.problem(), error.headers)


def _respond(request: Request, body: dict[str, Any], headers: dict[str, str] | None) -> JSONResponse:
    body["type"] = str(request.scope.get("root_path", "")).rstrip("/") + body["type"]
    body["instance"] = request.url.path
    body["request_id"] = getattr(request.state, "request_id", "")
    return JSONResponse(body, status_code=body["status"], headers=headers, media_type=PROBLEM_JSON)


def pointer(location: tuple[int | str, ...]) -> str:
    """A JSON pointer (RFC 6901) into the request."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in location)


def invalid(error: ValidationError) -> ServiceError:
    """The problem for a body that pydantic refused. Of one that is wrong in thousands of places it names none."""
    if (count := error.error_count()) > _MOST_DETAILS:
        return ValidationFailedError(f"the body is wrong in {count} places")
    return _from_details(error.errors(include_url=False, include_context=False, include_input=False))


def _from_details(details: list[ErrorDetails]) -> ServiceError:
    by_pointer: dict[str, list[str]] = {}
    for item in details:
        messages = by_pointer.setdefault(pointer(_place(item["loc"])), [])
        message = _in_words(item)
        if message not in messages:
            messages.append(message)
    # of a list that may also be a word, only what is wrong inside the list is worth saying
    around = {where[:end] for where in by_pointer for end, character in enumerate(where) if character == "/"}
    inner = [where for where in by_pointer if where not in around]
    return invalid_values({where: ", or ".join(by_pointer[where]) for where in inner})


def _in_words(item: ErrorDetails) -> str:
    """What pydantic says, unless it is that a text has not a pattern, or that a name is one too many."""
    if item["loc"] == ("query", "cursor"):
        return _NO_CURSOR
    message = message_of(item)
    return _WORDS.get(message, message)


def _place(location: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Where in the request something stands: pydantic also names members of unions, and what is a key."""
    if "metadata" in location:  # its names are the client's
        return location[:-1] if location[-1] == "[key]" else location
    return tuple(part for part in location if not _UNION_MEMBER.fullmatch(str(part)))


def given_twice(names: Iterable[str]) -> list[str]:
    """The names that are given more than once, each one time, sorted."""
    return sorted(name for name, times in Counter(names).items() if times > 1)


def invalid_values(errors: dict[str, str]) -> ServiceError:
    """The problem for values that are not allowed: what is wrong, by JSON pointer. It lists the first `MAX_ERRORS`."""
    where, detail = next(iter(errors.items()))
    items = [{"pointer": pointer, "detail": text} for pointer, text in islice(errors.items(), MAX_ERRORS)]
    cut = f"; errors has the first {MAX_ERRORS} of {len(errors)}" if len(errors) > MAX_ERRORS else ""
    return ValidationFailedError(f"{where or 'body'}: {detail}{cut}", errors=items)


@contextmanager
def file_at(place: str) -> Iterator[None]:
    """Inside the block a file that is refused, or cannot be had, is named by where the request has it."""
    try:
        yield
    except (TooLargeError, UnsupportedMediaError, UrlNotAllowedError, FetchFailedError) as error:
        error.errors = [{"pointer": place, "detail": error.detail}]
        raise


def allowed(app: FastAPI, scope: Scope) -> list[str]:
    """The methods that the address of a request takes: a route knows its own alone."""
    path = get_route_path(scope)
    # a word that has a meaning of its own, as in /videos/form, is no id. The schema knows too, and takes long to make
    named = [route for route in iter_route_contexts(app.routes) if route.path == path]
    if named:
        return [method for method in _METHODS if any(method in (route.methods or ()) for route in named)]
    return [
        method
        for method in _METHODS
        if any(route.matches({**scope, "method": method})[0] is Match.FULL for route in app.router.routes)
    ]


async def _on_service_error(request: Request, error: ServiceError) -> JSONResponse:
    return problem_response(request, error)


async def _on_invalid(request: Request, error: RequestValidationError) -> JSONResponse:
    return problem_response(request, _from_details(list(error.errors())))


async def _on_http_error(request: Request, error: HTTPException) -> JSONResponse:
    phrase = HTTPStatus(error.status_code).phrase
    name = phrase.lower().replace(" ", "-")
    kind = PROBLEMS.get(name) or ProblemType(name, phrase, error.status_code)
    headers, detail = dict(error.headers or {}), str(error.detail)
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = ", ".join(allowed(request.app, request.scope))
        detail = f"{request.method} is not for this address, which takes {headers['Allow']}"
    elif error.status_code == HTTPStatus.NOT_FOUND:  # no route has said it
        root = str(request.scope.get("root_path", "")).rstrip("/")
        detail = f"there is no such address; {root}/docs has those there are"
    return _respond(request, problem_body(kind, detail), headers)


async def _on_os_error(request: Request, error: OSError) -> JSONResponse:
    if is_disk_full(error):
        return problem_response(request, StorageFullError())
    raise error


async def _on_database_error(request: Request, error: SQLAlchemyError) -> JSONResponse:
    if is_disk_full(error):
        return problem_response(request, StorageFullError())
    return _away(request, error, "the records cannot be reached; try again")


async def _on_store_error(request: Request, error: BaseError) -> JSONResponse:
    return _away(request, error, "the files cannot be reached; try again")


def _away(request: Request, error: Exception, detail: str) -> JSONResponse:
    """The answer while the database or the store is away. Raises any other error of theirs again."""
    if not is_outage(error):
        raise error
    log.warning("answered as unavailable", path=request.url.path, error=type(error).__name__)
    return problem_response(request, UnavailableError(detail))


#: of an error, the handler of the nearest of its classes is taken
_HANDLERS: Final[dict[type[Exception], Callable[[Request, Any], Awaitable[JSONResponse]]]] = {
    ServiceError: _on_service_error,
    RequestValidationError: _on_invalid,
    HTTPException: _on_http_error,
    OSError: _on_os_error,
    SQLAlchemyError: _on_database_error,
    BaseError: _on_store_error,
}


def install(app: FastAPI) -> None:
    """Register the handlers of every error the application raises on purpose or through its framework."""
    for kind, handler in _HANDLERS.items():
        app.add_exception_handler(kind, handler)
