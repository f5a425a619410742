"""Streams of events that break, and what is asked for after them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Iterator

import httpx
import pytest

from pvg_client import ApiError, AsyncClient, Client, UnreachableError
from tests.client.test_retries import JOB, Script, pauses, problem

__all__ = ["pauses"]


class Stream(httpx.SyncByteStream, httpx.AsyncByteStream):
    """A body that comes in pieces of seven bytes, and may break after its last one."""

    def __init__(self, text: str, breaks: bool) -> None:
        self._data, self._breaks = text.encode(), breaks
        self.closed = False

    def __iter__(self) -> Iterator[bytes]:
        for start in range(0, len(self._data), 7):
            yield self._data[start : start + 7]
        if self._breaks:
            raise httpx.ReadError("cut")

    async def __aiter__(self) -> AsyncIterator[bytes]:
        for piece in self:
            yield piece

    def close(self) -> None:
        self.closed = True

    async def aclose(self) -> None:
        self.closed = True


def stream(*events: str, breaks: bool = False) -> httpx.Response:
    return httpx.Response(200, stream=Stream("retry: 2000\n\n" + "".join(events), breaks))


def event(event_id: str, fraction: float, state: str = "running") -> str:
    done = state == "succeeded"
    body = JOB | {"state": state, "done": done, "progress": {"stage": "render", "fraction": fraction}}
    return f"id: {event_id}\nevent: progress\ndata: {json.dumps(body)}\n\n"


def blocking(script: Script, retries: int = 8) -> list[float]:
    with Client("http://service.test", transport=script, retries=retries) as client:
        return [job.progress.fraction for job in client.events("job_1")]


def awaited(script: Script, retries: int = 8) -> list[float]:
    async def session() -> list[float]:
        async with AsyncClient("http://service.test", transport=script, retries=retries) as client:
            return [job.progress.fraction async for job in client.events("job_1")]

    return asyncio.run(session())


both = pytest.mark.parametrize("follow", [blocking, awaited])
Follow = Callable[..., list[float]]


@both
def test_a_broken_stream_goes_on_after_its_last_event(follow: Follow, pauses: list[float]) -> None:
    half = event("lost", 0.9)[:-20]
    script = Script(
        stream(event("a", 0.1), event("b", 0.2), half, breaks=True),
        problem(503),
        stream(":\n\n", event("c", 0.3)),  # the service stops
        stream(event("d", 1.0, "succeeded")),
    )
    assert follow(script) == [0.1, 0.2, 0.3, 1.0]
    assert [request.headers.get("last-event-id") for request in script.requests] == [None, "b", "b", "c"]
    assert {request.url.path for request in script.requests} == {"/v1/jobs/job_1/events"}
    assert len(pauses) == 3


@both
def test_an_end_that_was_told_is_the_end(follow: Follow, pauses: list[float]) -> None:
    assert follow(Script(httpx.Response(204))) == []


@both
def test_streams_without_events_are_not_opened_for_ever(follow: Follow, pauses: list[float]) -> None:
    with pytest.raises(UnreachableError, match="the stream ended"):
        follow(Script(*[stream() for _ in range(3)]), retries=2)
    # silence with signs of life may last
    assert follow(Script(*[stream(":\n\n") for _ in range(9)], stream(event("z", 1.0, "succeeded"))), retries=2) == [1]


@both
def test_a_job_that_is_not_there_is_told(follow: Follow, pauses: list[float]) -> None:
    with pytest.raises(ApiError) as caught:
        follow(Script(problem(404, "not-found")))
    assert caught.value.code == "not-found"


def test_who_stops_listening_closes_the_stream() -> None:
    answer = stream(event("a", 0.1), event("b", 0.2))
    with Client("http://service.test", transport=Script(answer)) as client:
        for _ in client.events("job_1"):
            break
    assert isinstance(answer.stream, httpx.SyncByteStream)
    assert answer.is_closed


def test_silence_is_borne_for_longer_than_between_comments() -> None:
    script = Script(stream(event("a", 1.0, "succeeded")))
    with Client("http://service.test", transport=script, timeout=5) as client:
        list(client.events("job_1"))
    timeouts = script.requests[0].extensions["timeout"]
    assert (timeouts["connect"], timeouts["read"]) == (5, 45)
