"""Errors of the HTTP interface: RFC 9457 problems. Each error class carries its own status and type."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

PROBLEM_JSON = "application/problem+json"

#: titles of the types that a failed job or medium may carry
TITLES = {
    "no-face": "No face was found",
    "face-too-small": "The face is too small",
    "media-invalid": "The file is not a video or image the service can read",
    "too-long": "The clip is too long",
    "too-large": "The file is too large",
    "asset-invalid": "The vectorised asset cannot be read",
    "validation-failed": "The request is not valid",
    "worker-crashed": "The job crashed its worker repeatedly",
    "time-limit": "The job took longer than allowed",
    "canceled": "The job was canceled",
    "expired": "The job waited too long in the queue",
    "internal-error": "Something went wrong on our side",
}


class ServiceError(Exception):
    """An answer that is an error. ``detail`` is shown to the client and never holds internals."""

    status: ClassVar[int] = 500
    type: ClassVar[str] = "internal-error"
    title: ClassVar[str] = TITLES["internal-error"]

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
        return problem_body(self.status, self.type, self.title, self.detail, self.errors)


class BadRequestError(ServiceError):
    """The request cannot be understood at all."""

    status = 400
    type = "malformed"
    title = "The request is malformed"


class NotFoundError(ServiceError):
    """There is no such thing, or it is another client's."""

    status = 404
    type = "not-found"
    title = "There is no such resource"


class ConflictError(ServiceError):
    """The thing is in a state that does not allow this."""

    status = 409
    type = "conflict"
    title = "The resource is in use or already finished"


class GoneError(ServiceError):
    """The thing existed, and its bytes have been removed."""

    status = 410
    type = "gone"
    title = "The resource has been removed"


class TooLargeError(ServiceError):
    """The body is over the limit. The rest of it is not read, so the connection closes."""

    status = 413
    type = "too-large"
    title = TITLES["too-large"]

    def __init__(self, detail: str) -> None:
        super().__init__(detail, headers={"Connection": "close"})


class UnsupportedMediaError(ServiceError):
    """The bytes are not of an allowed media type."""

    status = 415
    type = "unsupported-media-type"
    title = "The media type is not supported"


class RangeError(ServiceError):
    """The asked range lies outside the file."""

    status = 416
    type = "range-not-satisfiable"
    title = "The range cannot be satisfied"


class ValidationFailedError(ServiceError):
    """The request is well formed, and a value in it is not allowed."""

    status = 422
    type = "validation-failed"
    title = TITLES["validation-failed"]


class MediaFailedError(ServiceError):
    """The request names a medium whose vectorisation has failed; the type is the medium's own."""

    status = 422

    def __init__(self, error: dict[str, Any], pointer: str) -> None:
        super().__init__(str(error["detail"]), errors=[{"pointer": pointer, "detail": str(error["detail"])}])
        self._error = error

    def problem(self) -> dict[str, Any]:
        """The problem with the medium's type and title."""
        kind = str(self._error["type"])
        title = TITLES.get(kind, TITLES["internal-error"])
        return problem_body(self.status, kind, title, self.detail, self.errors)


class StorageFullError(ServiceError):
    """No room is left for the bytes."""

    status = 507
    type = "insufficient-storage"
    title = "The service has no room left"


class UnavailableError(ServiceError):
    """A part the answer needs is not there right now."""

    status = 503
    type = "unavailable"
    title = "The service is not available right now"

    def __init__(self, detail: str) -> None:
        super().__init__(detail, headers={"Retry-After": "5"})


def problem_body(
    status: int, kind: str, title: str, detail: str, errors: Sequence[dict[str, str]] = ()
) -> dict[str, Any]:
    """The members of an RFC 9457 problem."""
    body: dict[str, Any] = {"type": kind, "title": title, "status": status, "detail": detail}
    if errors:
        body["errors"] = list(errors)
    return body


def stored_problem(kind: str, detail: str) -> dict[str, str]:
    """The problem kept with a failed job or medium: it has no HTTP status of its own."""
    return {"type": kind, "title": TITLES[kind], "detail": detail}
