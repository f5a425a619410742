from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable
from contextlib import suppress

import pytest

from service.api import draining
from service.api.connections import BoundedProtocol
from service.api.draining import DECLARED_BYTES, OVER_BYTES
from tests.promises import Drill
from tests.service.fixtures import MP4, Api
from tests.waiting import until


def refused(
    api: Api, body: bytes, declared: int, *, call: str = "POST /nowhere", content_type: str = "video/mp4"
) -> tuple[str, int]:
    """Send `body` slowly to what refuses it: the status line, if one comes, and how much went out."""
    host, port = api.client.base_url.host, api.client.base_url.port
    sent, answer = min(len(body), 1000), b""
    with socket.create_connection((host, port), timeout=60) as connection:
        head = f"{call} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {declared}\r\nContent-Type: {content_type}\r\n\r\n"
        connection.sendall(head.encode() + body[:sent])

        def send() -> None:
            nonlocal sent
            with suppress(OSError):  # cut off, as the caller expects
                while sent < len(body):
                    connection.sendall(body[sent : sent + 65536])
                    sent = min(len(body), sent + 65536)

        sender = threading.Thread(target=send)
        sender.start()
        with suppress(ConnectionResetError):  # which may overtake the answer
            answer = connection.recv(4096)
        sender.join()
    return answer.split(b"\r\n")[0].decode(), sent


@pytest.mark.parametrize("size", [100_000, DECLARED_BYTES])
def test_the_answer_reaches_a_client_that_is_still_sending(
    api: Api, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draining, "DRAIN_S", 60.0)  # by when a busy machine has sent it all
    for _ in range(5):
        status, sent = refused(api, b"x" * size, size)
        assert status == "HTTP/1.1 404 Not Found"
        assert sent == size


LIMIT = 1024**2


def calls(api: Api) -> dict[str, str]:
    """What takes a mebibyte, by the type of its body."""
    link = api.client.post("/uploads/link", json={"max_bytes": LIMIT}).json()["url"]
    return {"application/json": "POST /transfer", "video/mp4": f"PUT {link}"}


def statuses(caplog: pytest.LogCaptureFixture) -> list[int]:
    """Those of the answers that the server has sent, but for that of the link, which may be logged late."""
    sent = [vars(record)["status"] for record in caplog.records if record.msg == "request"]
    return [status for status in sent if status != 201]


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many bytes the server has taken of its clients, each time that it has taken some."""
    taken: list[int] = []
    receive = BoundedProtocol.data_received

    def counted(self: BoundedProtocol, data: bytes) -> None:
        taken.append(len(data))
        receive(self, data)

    monkeypatch.setattr(BoundedProtocol, "data_received", counted)
    monkeypatch.setattr(draining, "DRAIN_S", 60.0)  # by when a busy machine has sent it all
    return taken


@pytest.mark.parametrize("content_type", ["application/json", "video/mp4"])
def test_of_a_body_that_is_too_large_less_than_a_mebibyte_over_its_limit_is_read(
    api: Api, read: list[int], content_type: str, promise: Callable[..., Drill], caplog: pytest.LogCaptureFixture
) -> None:
    drill = promise("R11", wanted="a little over a limit of 1 MiB: 413 before 1 MiB more is read")
    call = calls(api)[content_type]
    read.clear()
    body = MP4 + bytes(DECLARED_BYTES - len(MP4))
    with caplog.at_level(logging.INFO):
        caplog.clear()
        status, _ = refused(api, body, len(body), call=call, content_type=content_type)
        # a reset may overtake the answer on its way, so what was sent counts
        until(lambda: statuses(caplog) != [])
    drill.measured = f"{statuses(caplog)[0]} after {sum(read) / 1024:.0f} KiB of {len(body) / 1024:.0f}"
    assert statuses(caplog) == [413]
    assert status.startswith("HTTP/1.1 413 ") or not status
    assert sum(read) <= LIMIT + 1024**2


@pytest.mark.parametrize("content_type", ["application/json", "video/mp4"])
def test_a_body_that_is_a_little_too_large_is_read_to_its_end(api: Api, read: list[int], content_type: str) -> None:
    call = calls(api)[content_type]
    body = MP4 + bytes(LIMIT + OVER_BYTES - len(MP4))
    for _ in range(5):
        status, sent = refused(api, body, len(body), call=call, content_type=content_type)
        assert status.startswith("HTTP/1.1 413 ")
        assert sent == len(body)
        read.clear()


def test_a_refused_request_without_a_body_keeps_its_connection(api: Api) -> None:
    answer = api.client.post("/jobs/job_1/cancel")
    assert answer.status_code == 404
    assert "connection" not in answer.headers


def test_a_client_that_sends_without_end_is_cut_off(api: Api) -> None:
    _, sent = refused(api, b"x" * (32 * DECLARED_BYTES), 2**40)
    assert 0 < sent < 32 * DECLARED_BYTES


def test_a_client_that_stops_sending_is_answered_soon(api: Api) -> None:
    status, _ = refused(api, b"x" * 10, 1000)
    assert status == "HTTP/1.1 404 Not Found"
