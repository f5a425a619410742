"""Answers of somebody who is not the service: each is told as such, and asking again cannot help."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from pvg_client import AsyncClient, Client, Link, PvgClientError, UnreachableError
from pvg_client.models import Job
from tests.client.lines import MEDIUM
from tests.client.test_retries import JOB, NOW, Script

CALLS: dict[str, Callable[[Client], Any]] = {
    "medium": lambda client: client.medium("vid_1"),
    "videos": lambda client: list(client.videos()),
    "transfer": lambda client: client.transfer("vid_1", reference="ref_1"),
    "swap": lambda client: client.swap("vid_1", "vid_2"),
    "job": lambda client: client.job("job_1"),
    "jobs": lambda client: list(client.jobs()),
    "wait": lambda client: client.wait("job_1"),
    "cancel": lambda client: client.cancel("job_1"),
    "link": lambda client: client.link("res_1"),
    "upload by url": lambda client: client.upload(url="https://elsewhere.test/clip.mp4"),
    "upload": lambda client: client.upload(__file__),
    "upload_link": lambda client: client.upload_link(),
    "send_upload": lambda client: client.send_upload("http://service.test/v1/uploads/upl_1", __file__),
    "upload_state": lambda client: client.upload_state("upl_1"),
    "uploads": lambda client: list(client.uploads()),
    "webhook": lambda client: client.webhook("msg_1"),
    "replay": lambda client: client.replay("msg_1"),
    "webhook_secret": lambda client: client.webhook_secret(),
    "usage": lambda client: client.usage(),
    "limits": lambda client: client.limits(),
}
#: of those whose answers are no JSON
OTHERS: dict[str, Callable[[Client], Any]] = {
    "delete": lambda client: client.delete("vid_1"),
    "preview": lambda client: client.preview("vid_1"),
    "frame": lambda client: client.frame("vid_1", 0),
    "poster": lambda client: client.poster("vid_1"),
    "thumbnail": lambda client: client.thumbnail("vid_1", 0),
}
#: what no call takes for its answer
BODIES = (b"<html>log in</html>", b"", b"\xff", b"[1]", b"null", b'{"hello": 1}', b"[" * 100_000, b'{"data": [1]}')


def told_by(call: Callable[[], object]) -> None:
    with pytest.raises(UnreachableError, match=r"service\.test answers, but not as this service does") as caught:
        call()
    assert not caught.value.worth_another


@pytest.mark.parametrize("call", [*CALLS, *OTHERS])
def test_a_body_of_somebody_else_is_told(call: str) -> None:
    for body in BODIES:
        script = Script(httpx.Response(200, content=body))
        with Client("http://service.test", transport=script) as client:
            told_by(lambda client=client: (CALLS | OTHERS)[call](client))  # type: ignore[misc]
        assert len(script.requests) == 1


@pytest.mark.parametrize(
    "changed",
    [
        {"created_at": 5},
        {"created_at": "yesterday"},
        {"looks": 5},
        {"looks": [None]},
        {"progress": 1},
        {"timings": 1},
        {"eta": {}},
        {"error": "no"},
    ],
)
def test_a_job_with_members_of_other_kinds_is_somebody_elses(changed: dict[str, object]) -> None:
    with Client("http://service.test", transport=Script(httpx.Response(200, json=JOB | changed))) as client:
        told_by(lambda: client.job("job_1"))


def test_a_link_to_nowhere_is_somebody_elses() -> None:
    made = {"url": "http://service.test:door/", "expires_at": "2026-01-05T10:00:00Z"}
    with Client("http://service.test", transport=Script(httpx.Response(200, json=made))) as client:
        told_by(lambda: client.link("res_1"))


STREAMS = (b"data: {\n\n", b"data: [1]\n\n", b'data: {"hello": 1}\n\n', b"data: \xff\n\n", b"\x89PNG\r\n\n\n")


@pytest.mark.parametrize("content", STREAMS)
def test_a_stream_of_somebody_else_is_told(content: bytes) -> None:
    async def followed() -> list[Job]:
        async with AsyncClient("http://service.test", transport=Script(httpx.Response(200, content=content))) as client:
            return [job async for job in client.events("job_1")]

    with Client("http://service.test", transport=Script(httpx.Response(200, content=content))) as client:
        told_by(lambda: list(client.events("job_1")))
    told_by(lambda: asyncio.run(followed()))


@pytest.mark.parametrize(
    "answers",
    [
        [httpx.Response(201)],
        [httpx.Response(201, headers={"Location": "http://service.test:door/"})],
        [httpx.Response(201, headers={"Location": "/v1/uploads/upl_1"}), httpx.Response(204)],
        [httpx.Response(201, headers={"Location": "/v1/uploads/upl_1"}), *[httpx.Response(503), httpx.Response(200)]],
        *[
            [
                httpx.Response(201, headers={"Location": "/v1/uploads/upl_1", "Idempotent-Replayed": "true"}),
                httpx.Response(200, headers={"Upload-Offset": said}),
            ]
            for said in ("", "many", "-1")
        ],
    ],
)
def test_an_upload_in_pieces_to_somebody_else_is_told(
    answers: list[httpx.Response], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("pvg_client.client.time.sleep", lambda seconds: None)
    with Client("http://service.test", transport=Script(*answers)) as client:
        told_by(lambda: client.upload(__file__, resume=True))


@pytest.mark.parametrize("etag", [None, "", '"1-5f"', f'"../{"0" * 64}"'])
@pytest.mark.parametrize("folder", [True, False])
def test_a_file_of_somebody_else_is_not_fetched(tmp_path: Path, etag: str | None, folder: bool) -> None:
    script = Script(httpx.Response(200, headers={} if etag is None else {"ETag": etag}))
    with Client("http://service.test", transport=script) as client:
        told_by(lambda: client.download("res_1", tmp_path if folder else tmp_path / "look.mp4"))
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_file_is_not_downloaded(tmp_path: Path) -> None:
    link = Link("http://service.test/v1/results/res_1?signature=1", NOW)
    for thing in (link, Job.of(JOB | {"created_at": MEDIUM["created_at"]})):
        with Client(transport=Script()) as client, pytest.raises(TypeError, match="is no file"):
            client.download(thing, tmp_path / "look.mp4")  # type: ignore[arg-type]


def test_it_is_an_error_of_the_clients_own() -> None:
    with Client(transport=Script(httpx.Response(200, json={"hello": 1}))) as client, pytest.raises(PvgClientError):
        client.limits()
