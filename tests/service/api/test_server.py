from __future__ import annotations

import asyncio
import json
import resource
import socket
from collections.abc import Callable, Iterator

import httpx
import pytest
import uvicorn
from starlette.types import Message, Receive, Scope, Send

from service.api import create_app
from service.api.middleware import AnswerUnhandled, RequestContext
from service.api.server import connection_limit, listen, make_server, with_room
from service.catalog import Database, resumable
from service.settings import Settings
from tests.promises import Drill
from tests.service.fixtures import MP4, Api, make_tables, running
from tests.waiting import until


@pytest.fixture
def descriptors() -> Iterator[None]:
    """Puts the limit of descriptors back."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_an_address_in_use_is_named() -> None:
    with listen("127.0.0.1", 0)[0] as first:
        port = first.getsockname()[1]
        first.listen()
        with pytest.raises(OSError, match="in use") as caught:
            listen("127.0.0.1", port)
        assert caught.value.filename == f"127.0.0.1:{port}"


def test_every_address_of_a_host_has_the_same_port() -> None:
    sockets = listen("localhost", 0)
    try:
        assert len({one.getsockname()[1] for one in sockets}) == 1
        assert {one.family for one in sockets} <= {socket.AF_INET, socket.AF_INET6}
        assert all(one.getsockname()[0] in {"127.0.0.1", "::1"} for one in sockets)
    finally:
        for one in sockets:
            one.close()


def test_the_soft_limit_of_descriptors_is_raised_and_some_are_kept(descriptors: None) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (300, hard))
    assert connection_limit(20) == 20
    raised, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert raised == (min(hard, 16_384) if hard != resource.RLIM_INFINITY else 16_384)
    assert connection_limit(10**6) == raised - 256


def test_an_application_is_made_for_the_connections_that_there_is_room_for(descriptors: None) -> None:
    assert with_room(Settings(max_connections=20)).max_connections == 20
    assert with_room(Settings(max_connections=10**6)).max_connections == connection_limit(10**6) < 10**6


def answer_of_a_stop(server: uvicorn.Server, address: tuple[str, int], settings: Settings, sent: bytes) -> bytes:
    """What the beginning of a request is answered with when the server is told to stop once it has come."""
    with socket.create_connection(address, timeout=60) as connection:
        connection.sendall(sent)
        until(lambda: list(settings.spool_folder.iterdir()))
        server.should_exit = True
        answer = b""
        while data := connection.recv(65536):
            answer += data
    return answer


def test_an_upload_that_is_not_whole_when_the_service_has_to_stop_is_told_so(
    settings: Settings, promise: Callable[..., Drill]
) -> None:
    drill = promise("R8", wanted="an upload that takes longer: 503 with Retry-After and the request's id")
    make_tables(settings.database)
    server = make_server(create_app(settings), settings, drain_s=1)
    with running(server) as address:
        head = "POST /v1/videos HTTP/1.1\r\nHost: localhost\r\nX-Request-ID: mine\r\nContent-Length: 3000000"
        answer = answer_of_a_stop(server, address, settings, f"{head}\r\n\r\n".encode() + MP4)
    first, *lines = answer.partition(b"\r\n\r\n")[0].decode().lower().splitlines()
    drill.measured = first.partition(" ")[2]
    assert first == "http/1.1 503 service unavailable"
    problem = json.loads(answer.partition(b"\r\n\r\n")[2])
    assert {"content-type: application/problem+json", "connection: close", "retry-after: 5"} <= set(lines)
    assert "x-request-id: mine" in lines
    assert (problem["code"], problem["request_id"], problem["instance"]) == ("unavailable", "mine", "/v1/videos")
    assert list(settings.spool_folder.iterdir()) == []


@pytest.mark.parametrize("more", ["", "Expect: 100-continue\r\n"])
def test_what_has_come_of_a_piece_is_kept_when_the_service_has_to_stop(settings: Settings, more: str) -> None:
    make_tables(settings.database)
    app = create_app(settings.model_copy(update={"body_timeout_s": 600.0}))
    server = make_server(app, app.state.services.settings, drain_s=6)
    size, sent = 3_000_000, MP4 + bytes(1_000_000)
    tus = {"Tus-Resumable": "1.0.0", "Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
    with running(server) as (host, port), httpx.Client() as client:
        begun = client.post(f"http://{host}:{port}/v1/uploads", headers={**tus, "Upload-Length": str(size)})
        upload_id = begun.json()["id"]
        head = f"PATCH /v1/uploads/{upload_id} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {size}\r\n{more}"
        head += "".join(f"{name}: {value}\r\n" for name, value in tus.items())
        answer = answer_of_a_stop(server, (host, port), settings, f"{head}\r\n".encode() + sent)
    first, *lines = answer.removeprefix(b"HTTP/1.1 100 Continue\r\n\r\n").lower().split(b"\r\n")
    assert first == b"http/1.1 503 service unavailable"
    assert {b"retry-after: 5", b"connection: close", b"tus-resumable: 1.0.0"} <= set(lines)
    database = Database(settings.database)
    with database.read() as session:
        kept = resumable.get(session, upload_id, now=database.now())
    database.close()
    assert kept is not None
    assert kept.offset_bytes == len(sent)
    assert list(settings.spool_folder.iterdir()) == []


def test_an_answer_that_has_begun_when_the_service_has_to_stop_breaks_off(api: Api) -> None:
    sent: list[Message] = []

    async def begins(scope: Scope, receive: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await asyncio.sleep(60)

    async def receive() -> Message:
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        sent.append(message)

    async def cancel() -> None:
        app = RequestContext(AnswerUnhandled(begins), meters=api.services.meters, places=api.services.places)
        task = asyncio.create_task(app({"type": "http", "method": "GET", "path": "/", "headers": []}, receive, send))
        while not sent:
            await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(cancel())
    assert [message["type"] for message in sent] == ["http.response.start"]
