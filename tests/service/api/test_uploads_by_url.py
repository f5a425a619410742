from __future__ import annotations

import hashlib
import json
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from service.api import fetches
from service.settings import Settings
from tests.promises import Drill
from tests.service.fixtures import MP4, PNG, Api, serve
from tests.service.remote import PRIVATE, PUBLIC, Names, Remote, answer, connected, names, public_loopback, remote
from tests.waiting import until

__all__ = ["connected", "names", "public_loopback"]


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(data_dir=tmp_path / "data", reap_interval_s=3600, max_upload_bytes=1_000_000)


@pytest.fixture
def here(names: Names, public_loopback: None) -> Iterator[Remote]:
    names.tell("media.example", PUBLIC)
    with remote(PUBLIC) as server:
        server.answers["/my%20clip.mp4"] = answer(MP4 + b"a" * 300_000, Content_Type="text/html")
        server.answers["/face.png"] = answer(PNG + b"b")
        yield server


def at(server: Remote, path: str) -> str:
    return f"http://media.example:{server.port}{path}"


def test_a_file_may_be_named_by_its_url(api: Api, here: Remote, caplog: pytest.LogCaptureFixture) -> None:
    content = MP4 + b"a" * 300_000
    body = {"url": at(here, "/my%20clip.mp4?signature=secret"), "mask": "ycbcr", "metadata": {"order": "42"}}
    with caplog.at_level(logging.DEBUG):
        made = api.client.post("/videos", json=body)
    assert made.status_code == 202, made.text
    video = made.json()
    assert made.headers["location"] == f"/v1/videos/{video['id']}"
    assert video["sha256"] == hashlib.sha256(content).hexdigest()
    assert (video["filename"], video["content_type"], video["size_bytes"]) == ("my clip.mp4", "video/mp4", len(content))
    assert video["settings"]["mask"] == "ycbcr"
    assert video["metadata"] == {"order": "42"}
    assert "secret" not in caplog.text
    assert api.drafts == []
    # the same bytes, however they come
    again = api.client.post("/videos?mask=ycbcr", content=content)
    assert (again.status_code, again.json()["id"]) == (200, video["id"])
    reference = api.client.post("/references", json={"url": at(here, "/face.png")})
    assert (reference.status_code, reference.json()["content_type"]) == (202, "image/png")


def test_a_name_in_a_url_is_decoded_once(api: Api, here: Remote) -> None:
    for path, name in (("/50%2525.mp4", "50%25.mp4"), ("/in/a%2Fb%20c.mp4", "b c.mp4"), ("/%C3%A9.mp4", "é.mp4")):
        here.answers[path] = answer(MP4 + path.encode())
        made = api.client.post("/videos", json={"url": at(here, path + "?a=/x")})
        assert (made.status_code, made.json()["filename"]) == (202, name)


def test_a_url_is_fetched_once_for_an_idempotency_key(api: Api, here: Remote) -> None:
    key = {"Idempotency-Key": "order-42"}
    body = {"url": at(here, "/face.png")}
    first = api.client.post("/references", json=body, headers=key)
    second = api.client.post("/references", json={**body, "mask": "landmarks"}, headers=key)
    assert second.headers["idempotent-replayed"] == "true"
    assert second.json() == first.json()
    assert here.connections == 1
    other = api.client.post("/references", json=body | {"mask": "ycbcr"}, headers=key)
    assert other.json()["code"] == "idempotency-key-reused"


def _lying(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n" + MP4)
    for _ in range(100):
        connection.sendall(b"x" * 100_000)


@pytest.mark.parametrize(
    ("path", "status", "kind"),
    [
        ("/missing.mp4", 422, "fetch-failed"),
        ("/page.mp4", 415, "unsupported-media-type"),
        ("/empty.mp4", 415, "unsupported-media-type"),
        ("/large.mp4", 413, "too-large"),
        ("/lying.mp4", 413, "too-large"),
        ("/broken.mp4", 422, "fetch-failed"),
        ("/inside.mp4", 422, "url-not-allowed"),
    ],
)
def test_what_cannot_be_had_says_why_and_leaves_nothing(
    api: Api, here: Remote, path: str, status: int, kind: str
) -> None:
    here.answers |= {
        "/page.mp4": answer(b"<html>", Content_Type="video/mp4"),
        "/empty.mp4": answer(b""),
        "/large.mp4": lambda to: to.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000001\r\n\r\n" + MP4),
        "/lying.mp4": _lying,
        "/broken.mp4": lambda to: to.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n" + MP4),
        "/inside.mp4": answer(b"", "302 Found", Location=f"http://127.0.0.1:{here.port}/"),
    }
    refused = api.client.post("/videos", json={"url": at(here, path)}, headers={"Idempotency-Key": "a"})
    assert (refused.status_code, refused.json()["code"]) == (status, kind)
    assert refused.json()["errors"] == [{"pointer": "/url", "detail": refused.json()["detail"]}]
    assert api.blobs == []
    assert api.drafts == []
    # the key is free again
    assert (
        api.client.post("/videos", json={"url": at(here, path)}, headers={"Idempotency-Key": "a"}).json()["code"]
        == kind
    )


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"{", 400),
        (b"{}", 422),
        (b'{"url": 1}', 422),
        (b'{"url": "https://media.example/", "mask": "none"}', 422),
        (b'{"url": "https://media.example/", "speed": 1}', 422),
        (b'{"url": "file:///etc/passwd"}', 422),
    ],
)
def test_a_request_that_is_not_valid_is_refused_before_anything_is_asked_for(
    api: Api, here: Remote, body: bytes, status: int
) -> None:
    refused = api.client.post("/videos", content=body, headers={"content-type": "application/json"})
    assert refused.status_code == status
    assert here.connections == 0


def test_no_url_of_an_upload_leads_inside(
    api: Api, here: Remote, names: Names, connected: list[str], promise: Callable[..., Drill]
) -> None:
    drill = promise("R15", wanted="POST {url}: no connection to a non-global address")
    names.tell("inside.example", PRIVATE)
    names.tell("rebinding.example", PUBLIC, PRIVATE)
    with remote(PRIVATE, here.port) as inside:
        port = here.port
        leads = [
            *(f"http://{host}:{port}/" for host in ("127.0.0.1", "2130706433", "0x7f.1", "[::ffff:127.0.0.1]")),
            *(f"http://{host}:{port}/" for host in ("inside.example", "localhost", "[64:ff9b::7f00:1]")),
            "http://169.254.169.254/latest/meta-data/",
        ]
        for number, url in enumerate(leads):
            here.answers[f"/{number}"] = answer(b"", "302 Found", Location=url)
        here.answers["/again"] = answer(b"", "302 Found", Location="/")
        urls = [*leads, *(at(here, f"/{number}") for number in range(len(leads)))]
        urls.append(f"http://rebinding.example:{port}/again")
        answers = [api.client.post("/videos/url", json={"url": url}).json() for url in urls]
        kinds = {one["code"] for one in answers}
        assert {one["errors"][0]["pointer"] for one in answers} == {"/url"}
        drill.measured = f"{len(urls)} uploads, {inside.connections} connections inside"
        assert kinds == {"url-not-allowed"}
        assert inside.connections == 0
    # the client of this test itself has a connection to the API at 127.0.0.1
    assert set(connected) <= {PUBLIC, PRIVATE}


def test_a_file_that_does_not_come_in_time_is_given_up(tmp_path: Path, here: Remote) -> None:
    settings = Settings(data_dir=tmp_path / "data", reap_interval_s=3600, fetch_timeout_s=3)

    def stall(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n" + MP4)
        time.sleep(30)

    here.answers["/stalled.mp4"] = stall
    for api in serve(settings):
        refused = api.client.post("/videos", json={"url": at(here, "/stalled.mp4")})
        assert refused.json()["code"] == "fetch-failed"
        assert "in time" in refused.json()["detail"]
        assert api.drafts == []


def _held(here: Remote) -> tuple[threading.Event, threading.Event]:
    """An answer that begins and goes on when it is told to; whether the one who asked for it is gone."""
    go_on, ended = threading.Event(), threading.Event()

    def hold(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 40\r\n\r\n" + MP4)
        connection.settimeout(0.1)
        while not go_on.is_set():
            try:
                if connection.recv(1) == b"":
                    ended.set()
                    return
            except TimeoutError:
                continue
        connection.sendall(b"x" * (40 - len(MP4)))

    here.answers["/held.mp4"] = hold
    return go_on, ended


def test_a_fetch_ends_with_its_client(api: Api, here: Remote) -> None:
    _, ended = _held(here)
    body = json.dumps({"url": at(here, "/held.mp4")})
    head = f"POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {len(body)}"
    with socket.create_connection(api.address, timeout=60) as client:
        client.sendall(f"{head}\r\n\r\n{body}".encode())
        until(lambda: api.drafts)  # it is being fetched
    assert here.connections == 1
    assert ended.wait(60)
    until(lambda: api.drafts == [])
    assert api.services.fetches._of.total == 0
    assert api.blobs == []


def test_so_many_files_are_fetched_at_a_time(api: Api, here: Remote, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on, _ = _held(here)
    monkeypatch.setattr(fetches, "PER_OWNER", 2)
    statuses: list[int] = []

    def fetch() -> None:
        statuses.append(httpx.post(str(api.client.base_url.join("/videos")), json=body, timeout=120).status_code)

    body = {"url": at(here, "/held.mp4")}
    threads = [threading.Thread(target=fetch) for _ in range(2)]
    for thread in threads:
        thread.start()
    until(lambda: here.connections == 2)
    more = api.client.post("/videos", json=body)
    assert (more.status_code, more.json()["code"], more.json()["limit"]) == (429, "quota-exceeded", 2)
    monkeypatch.setattr(fetches, "PER_OWNER", 3)
    monkeypatch.setattr(fetches, "IN_ALL", 2)
    assert api.client.post("/videos", json=body).status_code == 503
    assert here.connections == 2
    go_on.set()
    for thread in threads:
        thread.join()
    assert set(statuses) <= {200, 202}
    assert api.client.post("/videos", json=body).status_code == 200
