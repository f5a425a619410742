"""What a call of this client does, without doing it: a generator of steps, which a blocking or an asyncio loop takes.

So the order of requests, what is asked again and when, and what the answers mean, is written once for both.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
import re
import time
import uuid
from collections.abc import AsyncIterator, Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any, Final, Protocol, TypeAlias, TypeVar

import httpx

from pvg_client._version import __version__
from pvg_client.errors import ApiError, DamagedError, UnreachableError
from pvg_client.models import Problem

#: what the paths of the service begin with
API_PATH = "/v1"
#: seconds: a service that wants to be left alone for longer is not waited for
LONGEST_PAUSE_S: Final = 60.0
_FIRST_PAUSE_S: Final = 0.5
_LONGEST_BACKOFF_S: Final = 10.0
#: seconds after the time that a call may take in which an answer to its last question may still come
_LAST_ANSWER_S: Final = 2.0
_TRY_AGAIN: Final = frozenset({429, 502, 503, 504})
_CHUNK_BYTES: Final = 256 * 1024
#: what keys are made of: headers carry little else
VISIBLE: Final = re.compile(r"[\x21-\x7e]+")

A = TypeVar("A")
T = TypeVar("T")
Params: TypeAlias = list[tuple[str, str]]


class Sink(Protocol):
    """Where the body of a good answer goes, piece by piece."""

    def begin(self, response: httpx.Response) -> None:
        """Make ready for this answer's body."""

    def write(self, data: bytes) -> None:
        """Take a piece of it."""


@dataclass(frozen=True, slots=True)
class Send:
    """A step: send a request. Its outcome is the answer.

    It has been read, unless it is a good one and went into a sink, or is ``left_open`` to be read as it comes.
    """

    request: httpx.Request
    into: Sink | None = None
    left_open: bool = False


@dataclass(frozen=True, slots=True)
class Pause:
    """A step: wait."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Work:
    """A step: do what takes long and needs no answer, such as to hash a file. Its outcome is what that gives."""

    do: Callable[[], Any]


Flow: TypeAlias = Generator[Send | Pause | Work, Any, T]


def sent(send: Send) -> Flow[httpx.Response]:
    """The answer of a request."""
    response: httpx.Response = yield send
    return response


def worked(do: Callable[[], T]) -> Flow[T]:
    """What some work gives."""
    outcome: T = yield Work(do)
    return outcome


class FilePart(httpx.SyncByteStream, httpx.AsyncByteStream):
    """A file as a body: read while it is sent, and from its beginning each time.

    It has ``size_bytes``, as its header says, also where the file has grown meanwhile. Raises `DamagedError` when the
    file has become shorter.
    """

    def __init__(self, path: Path, size_bytes: int) -> None:
        self._path = path
        self._size_bytes = size_bytes

    def __iter__(self) -> Iterator[bytes]:
        with self._path.open("rb") as file:
            for wanted in self._lengths():
                yield self._whole(file.read(wanted), wanted)

    async def __aiter__(self) -> AsyncIterator[bytes]:
        with self._path.open("rb") as file:
            for wanted in self._lengths():
                yield self._whole(await asyncio.to_thread(file.read, wanted), wanted)

    def _lengths(self) -> Iterator[int]:
        return (min(_CHUNK_BYTES, self._size_bytes - at) for at in range(0, self._size_bytes, _CHUNK_BYTES))

    def _whole(self, data: bytes, wanted: int) -> bytes:
        if len(data) < wanted:
            raise DamagedError(f"{self._path} has become shorter while it was sent")
        return data


@dataclass(frozen=True, slots=True)
class Api:
    """Where the service is, and how it is spoken to: ``timeout_s`` for each read and write, and ``retries``."""

    base_url: httpx.URL
    key: str | None = field(repr=False)
    timeout_s: float
    retries: int

    def at(self, path: str) -> httpx.URL:
        """The address of a path of the interface."""
        return self.base_url.copy_with(path=self.base_url.path.rstrip("/") + API_PATH + path)

    def named(self, reference: str) -> httpx.URL:
        """The address that an answer names: whole, or a path of the same host."""
        return self.base_url.join(reference)

    def request(
        self,
        method: str,
        where: str | httpx.URL,
        *,
        params: Params | None = None,
        headers: Mapping[str, str] | None = None,
        body: object = None,
        content: bytes | None = None,
        stream: FilePart | None = None,
        least_timeout_s: float = 0.0,
    ) -> httpx.Request:
        """A request with ``body`` as JSON, ``content`` or ``stream`` as they are, or none of them.

        ``least_timeout_s`` is for answers that take their time. The key goes to the service alone, to no other host
        that an answer may name.
        """
        url = self.at(where) if isinstance(where, str) else where
        # httpx adds no Host to a request with a stream of one's own
        sent = {"Host": url.netloc.decode("ascii"), "Accept": "*/*", "User-Agent": f"pvg-client/{__version__}"}
        sent |= headers or {}
        if self.key is not None and _origin(url) == _origin(self.base_url):
            sent["Authorization"] = f"Bearer {self.key}"
        if body is not None:
            sent["Content-Type"] = "application/json"
            content = json.dumps(body).encode()
        limits = httpx.Timeout(self.timeout_s, read=max(self.timeout_s, least_timeout_s)).as_dict()
        return httpx.Request(
            method,
            url.copy_merge_params(tuple(params)) if params else url,
            headers=sent,
            content=content,
            stream=stream,
            extensions={"timeout": limits},
        )


def _origin(url: httpx.URL) -> tuple[str, str, int | None]:
    return url.scheme, url.host, url.port


def of_metadata(metadata: Mapping[str, str] | None) -> Params:
    """Metadata as a query has them, a pair each."""
    return [("metadata", f"{name}:{value}") for name, value in (metadata or {}).items()]


def once(key: str | None) -> dict[str, str]:
    """The header that lets a POST be sent again: of the caller's own key, or of a new one.

    Raises `ValueError` for a key that no header can carry.
    """
    if key and not VISIBLE.fullmatch(key):
        raise ValueError("the idempotency_key has spaces, line breaks or letters that are not ASCII within")
    return {"Idempotency-Key": key or str(uuid.uuid4())}


def attempt(request: httpx.Request, into: Sink | None = None, *, left_open: bool = False) -> Flow[httpx.Response]:
    """The good answer of one request. Raises `ApiError` and `UnreachableError`."""
    try:
        response = yield from sent(Send(request, into, left_open))
    except httpx.HTTPError as error:
        raise unreachable(request, error) from error
    if response.is_success:
        return response
    raise ApiError(response.status_code, _problem(response), _retry_after_s(response))


def unreachable(request: httpx.Request, error: httpx.HTTPError) -> UnreachableError:
    """What an error of httpx, on the way there or back, is to the caller."""
    passing = isinstance(error, httpx.NetworkError | httpx.TimeoutException | httpx.RemoteProtocolError)
    what = f"{request.method} {request.url.copy_with(query=None)}"
    return UnreachableError(f"{what}: {error or type(error).__name__}", worth_another=passing)


class Patience:
    """How often something that failed is tried again, and after how long.

    What has a time to end at, ``until`` by `time.monotonic`, is tried as often as it takes.
    """

    def __init__(self, api: Api, until: float = math.inf) -> None:
        self._retries = api.retries if until == math.inf else math.inf
        self._until = until
        self.renew()

    def renew(self) -> None:
        """Something was achieved: count from anew."""
        self._failed = 0
        self._backoff_s = _FIRST_PAUSE_S

    def after(self, error: ApiError | UnreachableError) -> Flow[None]:
        """Wait before the next attempt. Raises the error itself when there is to be none, or `TimeoutError`."""
        least_s = (error.retry_after_s or 0.0) if isinstance(error, ApiError) else 0.0
        self._failed += 1
        if self._failed > self._retries or not _passing(error) or least_s > LONGEST_PAUSE_S:
            raise error
        # spread, so that many clients of a service that was away do not come back as one
        pause_s = max(least_s, self._backoff_s * random.uniform(0.5, 1))  # noqa: S311 - no secret
        self._backoff_s = min(2 * self._backoff_s, _LONGEST_BACKOFF_S)
        left_s = max(0.0, self._until - time.monotonic())
        yield Pause(min(pause_s, left_s))
        if pause_s >= left_s:
            raise TimeoutError(f"there was no time to ask again: {error}") from error


def _passing(error: ApiError | UnreachableError) -> bool:
    if isinstance(error, UnreachableError):
        return error.worth_another
    return error.status in _TRY_AGAIN or error.code == "idempotency-key-in-use"


def answered(api: Api, request: httpx.Request, *, until: float = math.inf) -> Flow[httpx.Response]:
    """The good answer of a request that may be sent again, ``until`` then.

    Raises `ApiError`, `UnreachableError`, and `TimeoutError` when there is no time left.
    """
    patience = Patience(api, until)
    limits = request.extensions["timeout"]
    while True:
        left_s = max(0.0, until - time.monotonic()) + _LAST_ANSWER_S
        request.extensions["timeout"] = {name: min(limit, left_s) for name, limit in limits.items()}
        try:
            return (yield from attempt(request))
        except (ApiError, UnreachableError) as error:
            yield from patience.after(error)


def headed(
    api: Api, url: httpx.URL, *, headers: Mapping[str, str] | None = None, to_get: Mapping[str, str]
) -> Flow[httpx.Headers]:
    """The headers of an answer, by HEAD. The errors of those have no body: what is wrong is asked for by GET.

    That is done once, with the headers ``to_get``.
    """
    try:
        response = yield from answered(api, api.request("HEAD", url, headers=headers))
    except ApiError as error:
        try:
            yield from attempt(api.request("GET", url, headers=to_get))
        except ApiError as told:
            if told.status == error.status:
                raise told from None
        except UnreachableError:
            pass  # the first one is the one to tell of
        raise
    return response.headers


def asked(
    api: Api, read: Callable[[dict[str, Any]], T], method: str, path: str, *, until: float = math.inf, **given: Any
) -> Flow[T]:
    """What ``read`` makes of the JSON object that a request is answered with."""
    response = yield from answered(api, api.request(method, path, **given), until=until)
    return body_of(response, read)


def body_of(response: httpx.Response, read: Callable[[dict[str, Any]], T]) -> T:
    """What ``read`` makes of the JSON object of a good answer."""
    return understood(response.url, lambda content: read(object_of(content)), response.content)


def understood(url: httpx.URL, read: Callable[[A], T], answer: A) -> T:
    """What ``read`` makes of a part of an answer. Raises `UnreachableError` when it cannot: somebody else answers."""
    try:
        return read(answer)
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError, httpx.InvalidURL) as error:
        raise UnreachableError(f"{url.host} answers, but not as this service does", worth_another=False) from error


def object_of(content: str | bytes) -> dict[str, Any]:
    """A JSON object. Raises `ValueError` for what is none, and `RecursionError`."""
    body = json.loads(content)
    if not isinstance(body, dict):
        raise ValueError("it is JSON, but no object")
    return body


def _problem(response: httpx.Response) -> Problem:
    try:
        told = Problem.of(object_of(response.content))
    except (RecursionError, ValueError):
        told = Problem.of({})  # a proxy in between has none
    return replace(told, title=told.title or response.reason_phrase, status=told.status or response.status_code)


def _retry_after_s(response: httpx.Response) -> float | None:
    """Seconds that the service wants to be left alone (RFC 9110, 10.2.3): a number, or a date."""
    text = response.headers.get("retry-after", "").strip()
    if text.isascii() and text.isdigit():
        return float(text)
    try:
        return max(0.0, (parsedate_to_datetime(text) - datetime.now(UTC)).total_seconds())
    except (ValueError, TypeError, OverflowError):
        return None
