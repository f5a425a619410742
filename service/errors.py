"""Errors of the HTTP interface: RFC 9457 problems. Every problem's type, title and status are defined here, once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from pydantic_core import ErrorDetails

PROBLEM_JSON: Final = "application/problem+json"


@dataclass(frozen=True)
class ProblemType:
    """A kind of problem: its `type`, its title, and the HTTP status of an answer of this kind."""

    type: str
    title: str
    status: int


#: every kind of problem that the service makes itself, by type
PROBLEMS: Final = {
    problem.type: problem
    for problem in (
        ProblemType("malformed", "The request is malformed", 400),
        ProblemType("not-found", "There is no such resource", 404),
        ProblemType("conflict", "The resource is in use or already finished", 409),
        ProblemType("gone", "The resource has been removed", 410),
        ProblemType("too-large", "The file is too large", 413),
        ProblemType("unsupported-media-type", "The media type is not supported", 415),
        ProblemType("range-not-satisfiable", "The range cannot be satisfied", 416),
        ProblemType("validation-failed", "The request is not valid", 422),
        # why a job or a medium has failed; an answer has these when the request names that medium
        ProblemType("no-face", "No face was found", 422),
        ProblemType("face-too-small", "The face is too small", 422),
        ProblemType("media-invalid", "The file is not a video or image the service can read", 422),
        ProblemType("asset-invalid", "The vectorised asset cannot be read", 422),
        ProblemType("worker-crashed", "The job crashed its worker repeatedly", 422),
        ProblemType("time-limit", "The job took longer than allowed", 422),
        ProblemType("canceled", "The job was canceled", 422),
        ProblemType("expired", "The job waited too long in the queue", 422),
        ProblemType("internal-error", "Something went wrong on our side", 500),
        ProblemType("unavailable", "The service is not available right now", 503),
        ProblemType("insufficient-storage", "The service has no room left", 507),
    )
}


class ServiceError(Exception):
    """An answer that is an error. ``detail`` is shown to the client and never holds internals."""

    kind: ClassVar[ProblemType] = PROBLEMS["internal-error"]

    def __init__(
        self,
        detail: str,
        *,
        errors: Sequence[dict[str, str]] = (),
        headers: dict[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.errors = list(errors)
        self.headers = headers or {}

    def problem(self) -> dict[str, Any]:
        """The problem's own members, without what belongs to the request."""
        return problem_body(self.kind, self.detail, self.errors)


class BadRequestError(ServiceError):
    """The request cannot be understood at all."""

    kind = PROBLEMS["malformed"]


class NotFoundError(ServiceError):
    """There is no such thing, or it is another client's."""

    kind = PROBLEMS["not-found"]


class ConflictError(ServiceError):
    """The thing is in a state that does not allow this."""

    kind = PROBLEMS["conflict"]


class GoneError(ServiceError):
    """The thing existed, and its bytes have been removed."""

    kind = PROBLEMS["gone"]


class TooLargeError(ServiceError):
    """The body is over the limit. The rest of it is not read, so the connection closes."""

    kind = PROBLEMS["too-large"]

    def __init__(self, detail: str) -> None:
        super().__init__(detail, headers={"Connection": "close"})


class UnsupportedMediaError(ServiceError):
    """The bytes are not of an allowed media type."""

    kind = PROBLEMS["unsupported-media-type"]


class RangeError(ServiceError):
    """The requested range lies outside the file."""

    kind = PROBLEMS["range-not-satisfiable"]


class ValidationFailedError(ServiceError):
    """The request is well formed, and a value in it is not allowed."""

    kind = PROBLEMS["validation-failed"]


class MediaFailedError(ServiceError):
    """The request names a medium whose vectorisation has failed: 422 with the medium's own type and title."""

    def __init__(self, error: dict[str, Any], pointer: str) -> None:
        super().__init__(str(error["detail"]), errors=[{"pointer": pointer, "detail": str(error["detail"])}])
        self._error = error

    def problem(self) -> dict[str, Any]:
        """The problem with the medium's type and title."""
        kind = ProblemType(str(self._error["type"]), str(self._error["title"]), ValidationFailedError.kind.status)
        return problem_body(kind, self.detail, self.errors)


class StorageFullError(ServiceError):
    """No room is left for the bytes."""

    kind = PROBLEMS["insufficient-storage"]


class UnavailableError(ServiceError):
    """A part that the answer needs cannot be reached right now."""

    kind = PROBLEMS["unavailable"]

    def __init__(self, detail: str) -> None:
        super().__init__(detail, headers={"Retry-After": "5"})


def problem_body(kind: ProblemType, detail: str, errors: Sequence[dict[str, str]] = ()) -> dict[str, Any]:
    """The members of an RFC 9457 problem."""
    body: dict[str, Any] = {"type": kind.type, "title": kind.title, "status": kind.status, "detail": detail}
    if errors:
        body["errors"] = list(errors)
    return body


def stored_problem(kind: str, detail: str) -> dict[str, str]:
    """The problem kept with a failed job or medium: it has no HTTP status of its own.

    Raises `KeyError` when ``kind`` is not the type of one of `PROBLEMS`.
    """
    return {"type": kind, "title": PROBLEMS[kind].title, "detail": detail}


def message_of(detail: ErrorDetails) -> str:
    """What pydantic says is wrong with a value, without its name for our own checks."""
    return detail["msg"].removeprefix("Value error, ")
