"""Files that change while they are the body of a request: it has the length that was said, or is given up."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from pvg_client import AsyncClient, Client, DamagedError
from tests.client.lines import MEDIUM

CONTENT = os.urandom(600_000)
UPLOAD = {"id": "upl_1", "role": "video", "filename": None, "size_bytes": None, "offset_bytes": 0, "media": None}
LINK = "http://127.0.0.1:8000/v1/uploads/upl_1?expires=1&signature=a"


class Line(httpx.BaseTransport, httpx.AsyncBaseTransport):
    """Takes the bodies of requests, and gives ``file`` another content before it reads the first byte of one."""

    def __init__(self, file: Path, content: bytes) -> None:
        self._file = file
        self._content = content
        self.arrived: list[tuple[str, bytes]] = []

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        self._file.write_bytes(self._content)
        return self._answer(request, request.read())

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        self._file.write_bytes(self._content)
        return self._answer(request, await request.aread())

    def _answer(self, request: httpx.Request, body: bytes) -> httpx.Response:
        self.arrived.append((request.headers["content-length"], body))
        return httpx.Response(200, json=MEDIUM | UPLOAD)


def blocking(file: Path, line: Line) -> None:
    with Client(transport=line) as client:
        client.upload(file)


def awaited(file: Path, line: Line) -> None:
    async def session() -> None:
        async with AsyncClient(transport=line) as client:
            await client.upload(file)

    asyncio.run(session())


def by_link(file: Path, line: Line) -> None:
    with Client(transport=line) as client:
        client.send_upload(LINK, file)


every_way = pytest.mark.parametrize("send", [blocking, awaited, by_link])
Send = Callable[[Path, Line], None]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "clip.mp4"
    path.write_bytes(CONTENT)
    return path


@every_way
def test_of_a_file_that_grows_what_was_hashed_is_sent(file: Path, send: Send) -> None:
    line = Line(file, CONTENT + CONTENT)
    send(file, line)
    assert line.arrived == [(str(len(CONTENT)), CONTENT)]


@every_way
@pytest.mark.parametrize("left", [0, 1000, len(CONTENT) - 1])
def test_a_file_that_becomes_shorter_is_given_up(file: Path, send: Send, left: int) -> None:
    line = Line(file, CONTENT[:left])
    with pytest.raises(DamagedError, match=r"clip\.mp4 has become shorter while it was sent"):
        send(file, line)
    assert line.arrived == []
