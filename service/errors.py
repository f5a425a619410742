"""Errors of the HTTP interface: RFC 9457 problems. Every problem's type, title and status are defined here, once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Final, Self

from pydantic_core import ErrorDetails

PROBLEM_JSON: Final = "application/problem+json"
#: the page of the service that tells of all kinds of problems
PROBLEMS_PAGE: Final = "/docs/problems"


@dataclass(frozen=True)
class ProblemType:
    """A kind of problem: its code, its title, and the HTTP status of an answer of this kind."""

    type: str
    title: str
    status: int


@dataclass(frozen=True)
class Limit:
    """What a request went over: the most that is allowed, and of what."""

    limit: float
    unit: str


#: every kind of problem that the service makes itself, by type
PROBLEMS: Final = {
    problem.type: problem
    for problem in (
        ProblemType("malformed", "The request is malformed", 400),
        ProblemType("unauthorized", "The key is missing or not valid", 401),
        ProblemType("forbidden", "This is not allowed", 403),
        ProblemType("not-found", "There is no such resource", 404),
        ProblemType("method-not-allowed", "The address does not take this method", 405),
        ProblemType("too-slow", "The request came too slowly", 408),
        ProblemType("conflict", "The state of the resource does not allow this", 409),
        ProblemType("idempotency-key-in-use", "The first request with this Idempotency-Key is not finished", 409),
        ProblemType("gone", "The resource has been removed", 410),
        ProblemType("precondition-failed", "A condition of the request does not hold", 412),
        ProblemType("too-large", "The file or the body is too large", 413),
        ProblemType("unsupported-media-type", "The media type is not supported", 415),
        ProblemType("range-not-satisfiable", "The range cannot be satisfied", 416),
        ProblemType("misdirected", "The request is for another host", 421),
        ProblemType("header-too-large", "The header of the request is too large", 431),
        ProblemType("validation-failed", "The request is not valid", 422),
        ProblemType("checksum-mismatch", "The bytes do not match their checksum", 460),
        ProblemType("idempotency-key-reused", "The Idempotency-Key was used for another request", 422),
        ProblemType("url-not-allowed", "The URL is not allowed", 422),
        ProblemType("fetch-failed", "The file could not be fetched", 422),
        # why a job or a medium has failed; an answer has these when the request names that medium
        ProblemType("no-face", "No face was found", 422),
        ProblemType("face-too-small", "The face is too small", 422),
        ProblemType("too-long", "The clip is too long", 422),
        ProblemType("media-invalid", "The file is not a video or image the service can read", 422),
        ProblemType("asset-invalid", "The vectorised asset cannot be read", 422),
        ProblemType("source-lost", "The uploaded file is lost", 422),
        ProblemType("worker-crashed", "The job crashed its worker repeatedly", 422),
        ProblemType("time-limit", "The job took longer than allowed", 422),
        ProblemType("canceled", "The work was canceled", 422),
        ProblemType("expired", "The work waited too long in the queue", 422),
        ProblemType("quota-exceeded", "A limit is used up", 429),
        ProblemType("internal-error", "Something went wrong on our side", 500),
        ProblemType("not-implemented", "The transfer coding is not supported", 501),
        ProblemType("unavailable", "The service is not available right now", 503),
        ProblemType("insufficient-storage", "The service has no room left", 507),
    )
}

#: why a medium may have failed, of kinds that are told with 422 alone
OF_FAILED: Final = frozenset(
    {
        *("no-face", "face-too-small", "too-long", "media-invalid", "asset-invalid", "source-lost", "worker-crashed"),
        *("time-limit", "canceled", "expired"),
    }
)
#: kinds of other statuses that a medium or job may have failed with: told with 422 where a request names such a medium
ALSO_OF_FAILED: Final = ("too-large", "internal-error", "unavailable", "insufficient-storage")


class ServiceError(Exception):
    """An answer that is an error. ``detail`` is shown to the client and never holds internals."""

    kind: ClassVar[ProblemType] = PROBLEMS["internal-error"]

    def __init__(
        self,
        detail: str,
        *,
        errors: Sequence[dict[str, str]] = (),
        headers: dict[str, str] | None = None,
        limit: Limit | None = None,
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.errors = list(errors)
        self.headers = headers or {}
        self.limit = limit

    def problem(self) -> dict[str, Any]:
        """The problem's own members, without what belongs to the request."""
        return problem_body(self.kind, self.detail, self.errors, self.limit)


class BadRequestError(ServiceError):
    """The request cannot be understood at all."""

    kind = PROBLEMS["malformed"]


class UnauthorizedError(ServiceError):
    """The request has no key, or none that is good (RFC 6750, 3)."""

    kind = PROBLEMS["unauthorized"]

    def __init__(self, detail: str, *, invalid: bool) -> None:
        challenge = 'Bearer realm="pvg"' + (', error="invalid_token"' if invalid else "")
        super().__init__(detail, headers={"WWW-Authenticate": challenge})


class ForbiddenError(ServiceError):
    """The request is understood and refused, whoever repeats it."""

    kind = PROBLEMS["forbidden"]


class MisdirectedError(ServiceError):
    """The request names a host that is not this service."""

    kind = PROBLEMS["misdirected"]


class NotFoundError(ServiceError):
    """There is no such thing, or it is another client's."""

    kind = PROBLEMS["not-found"]


class ConflictError(ServiceError):
    """The thing is in a state that does not allow this."""

    kind = PROBLEMS["conflict"]


class IdempotencyKeyInUseError(ServiceError):
    """Another request with the same Idempotency-Key is being worked on."""

    kind = PROBLEMS["idempotency-key-in-use"]

    def __init__(self, detail: str, *, retry_after_s: int) -> None:
        super().__init__(detail, headers={"Retry-After": str(retry_after_s)})


class GoneError(ServiceError):
    """The thing existed, and its bytes have been removed."""

    kind = PROBLEMS["gone"]


class PreconditionError(ServiceError):
    """The request is for another state of the thing, or speaks a version of a protocol that the service does not."""

    kind = PROBLEMS["precondition-failed"]


class ChecksumError(ServiceError):
    """The bytes were damaged on the way (tus 1.0, checksum extension)."""

    kind = PROBLEMS["checksum-mismatch"]


class TooLargeError(ServiceError):
    """The body is over the limit. The rest of it is not read, so the connection closes."""

    kind = PROBLEMS["too-large"]

    def __init__(self, detail: str, *, limit_bytes: int) -> None:
        super().__init__(detail, headers={"Connection": "close"}, limit=Limit(limit_bytes, "bytes"))


class UnsupportedMediaError(ServiceError):
    """The bytes are not of an allowed media type."""

    kind = PROBLEMS["unsupported-media-type"]


class RangeError(ServiceError):
    """The requested range lies outside the file."""

    kind = PROBLEMS["range-not-satisfiable"]


class ValidationFailedError(ServiceError):
    """The request is well formed, and a value in it is not allowed."""

    kind = PROBLEMS["validation-failed"]

    @classmethod
    def at(cls, pointer: str, detail: str, *, limit: Limit | None = None) -> Self:
        """The one value that is not allowed stands there in the request, as a JSON pointer."""
        return cls(detail, errors=[{"pointer": pointer, "detail": detail}], limit=limit)


class UrlNotAllowedError(ServiceError):
    """The URL is malformed, or leads to what is not on the public internet."""

    kind = PROBLEMS["url-not-allowed"]


class FetchFailedError(ServiceError):
    """A URL that was given does not answer, or not with what is wanted."""

    kind = PROBLEMS["fetch-failed"]


class IdempotencyKeyReusedError(ServiceError):
    """The Idempotency-Key was used for a request that was not the same."""

    kind = PROBLEMS["idempotency-key-reused"]


class QuotaExceededError(ServiceError):
    """The key has used up a quota, or has as much at work as it may: ``limit`` says of what."""

    kind = PROBLEMS["quota-exceeded"]


class MediaFailedError(ServiceError):
    """The request names a medium whose vectorisation has failed: 422 with the medium's own type and title.

    ``failed`` are all that have, by where the request has them, as JSON pointers: none where its path names the one.
    """

    kind = PROBLEMS["validation-failed"]

    def __init__(self, error: dict[str, Any], failed: Mapping[str, dict[str, Any]]) -> None:
        errors = [{"pointer": where, "detail": str(one["detail"])} for where, one in failed.items()]
        super().__init__(str(error["detail"]), errors=errors)
        self._error = error

    def problem(self) -> dict[str, Any]:
        """The problem with the medium's type and title."""
        kind = ProblemType(str(self._error["type"]), str(self._error["title"]), self.kind.status)
        return problem_body(kind, self.detail, self.errors, limit_of(self._error))


class StorageFullError(ServiceError):
    """No room is left for the bytes."""

    kind = PROBLEMS["insufficient-storage"]

    def __init__(self) -> None:
        super().__init__("no room is left for this; try again later")


class UnavailableError(ServiceError):
    """A part that the answer needs cannot be reached right now."""

    kind = PROBLEMS["unavailable"]

    def __init__(self, detail: str) -> None:
        super().__init__(detail, headers={"Retry-After": "5"})


class StoppingError(UnavailableError):
    """The service stops, and begins nothing more; whoever is asked for has no part in it."""


def type_of(code: str, root_path: str = "") -> str:
    """The `type` of a problem (RFC 9457, 3.1.1): where the service itself tells of it."""
    return f"{root_path}{PROBLEMS_PAGE}#{code}"


def shown(stored: dict[str, Any] | None, root_path: str) -> dict[str, Any] | None:
    """Why a job or a medium failed, from how it is kept: the address of its type depends on where the service is."""
    return None if stored is None else {**stored, "code": stored["type"], "type": type_of(stored["type"], root_path)}


def of_medium(stored: Mapping[str, Any], media_id: str) -> dict[str, Any]:
    """Why a medium failed, for whoever names it in a request: "the job" would be taken for that of the request."""
    details = {
        "canceled": f"the vectorising of {media_id} was canceled; upload the file again",
        "expired": f"no worker took up the vectorising of {media_id} in time; upload the file again",
    }
    kind = stored["type"]
    told = {"title": PROBLEMS[kind].title, "detail": details[kind]} if kind in details else {}
    return {**stored, **told}


def limit_of(stored: Mapping[str, Any]) -> Limit | None:
    """The limit that a stored problem names."""
    return Limit(stored["limit"], stored["unit"]) if "limit" in stored else None


def problem_body(
    kind: ProblemType, detail: str, errors: Sequence[dict[str, str]] = (), limit: Limit | None = None
) -> dict[str, Any]:
    """The members of an RFC 9457 problem; ``code``, ``limit`` and ``unit`` are our own."""
    body: dict[str, Any] = {"type": type_of(kind.type), "code": kind.type, "title": kind.title}
    body |= {"status": kind.status, "detail": detail}
    if errors:
        body["errors"] = list(errors)
    return body | ({} if limit is None else asdict(limit))


def stored_problem(
    kind: str, detail: str, errors: Sequence[dict[str, str]] = (), limit: Limit | None = None
) -> dict[str, Any]:
    """The problem kept with a failed job or medium: it has no HTTP status of its own.

    ``errors`` say where in the request of the job something is wrong, ``limit`` what the file is over. Raises
    `KeyError` when ``kind`` is not the type of one of `PROBLEMS`.
    """
    stored: dict[str, Any] = {"type": kind, "title": PROBLEMS[kind].title, "detail": detail}
    stored |= {"errors": list(errors)} if errors else {}
    return stored | ({} if limit is None else asdict(limit))


def message_of(detail: ErrorDetails) -> str:
    """What pydantic says is wrong with a value, without its name for our own checks, or ours for what is an object."""
    if detail["type"] == "model_type":
        return "Input should be an object"
    return detail["msg"].removeprefix("Value error, ")
