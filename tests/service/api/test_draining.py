from __future__ import annotations

import socket
import threading
from contextlib import suppress

import pytest

from service.api import draining
from service.api.draining import DECLARED_BYTES
from tests.service.fixtures import Api


def refused(api: Api, body: bytes, declared: int) -> tuple[str, int]:
    """Post `body` slowly to a path that refuses it at once: the status line, if one comes, and how much went out."""
    host, port = api.client.base_url.host, api.client.base_url.port
    sent, answer = min(len(body), 1000), b""
    with socket.create_connection((host, port), timeout=60) as connection:
        head = f"POST /nowhere HTTP/1.1\r\nHost: {host}\r\nContent-Length: {declared}\r\n\r\n"
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
