"""A key's requests, however slow, leave connections to others."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from service.settings import Settings
from tests.service.api.test_authentication import Holder, holder
from tests.service.fixtures import MP4, Api, make_ready, make_results, serve
from tests.waiting import until


@pytest.fixture
def narrow(tmp_path: Path) -> Iterator[Api]:
    """An API of twelve connections."""
    yield from serve(Settings(data_dir=tmp_path / "data", reap_interval_s=3600, max_connections=12))


@pytest.fixture
def wide(tmp_path: Path) -> Iterator[Api]:
    """One of 64 connections: 16 for a key, 8 for its links, 2 for one of them."""
    yield from serve(Settings(data_dir=tmp_path / "data", reap_interval_s=3600, max_connections=64))


def send_slowly(api: Api, stack: ExitStack, method: str, path: str, key: Holder | None = None) -> socket.socket:
    """A request whose body has come in part."""
    sender = stack.enter_context(socket.create_connection(api.address, timeout=60))
    whose = f"Authorization: Bearer {key.text}\r\n" if key is not None else ""
    head = f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n{whose}Content-Length: 100000\r\n\r\n"
    sender.sendall(head.encode() + MP4)
    return sender


def test_a_key_has_a_quarter_of_the_connections_and_others_have_the_rest(narrow: Api) -> None:
    one, other = holder(narrow), holder(narrow)
    video = one.upload().json()
    make_ready(narrow.services, video["id"])
    job = one.transfer(video["id"], video["id"]).json()
    (result,) = make_results(narrow.services, job["id"], [b"result"])
    download = one.post(f"/results/{result}/link").json()["url"]
    links = [one.post("/uploads/link", json={}).json()["url"] for _ in range(2)]
    with ExitStack() as stack:
        for _ in range(2):
            send_slowly(narrow, stack, "POST", "/videos", one)
        send_slowly(narrow, stack, "PUT", links[0])  # whoever has a link of the key
        until(lambda: len(narrow.drafts) == 3)
        for path in ("/videos", f"/results/{result}"):
            refused = one.get(path)
            assert (refused.status_code, refused.headers["retry-after"]) == (429, "5")
            assert (refused.json()["limit"], refused.json()["unit"]) == (3, "requests at a time")
        assert narrow.client.get(download).status_code == 429
        assert narrow.client.put(links[1], content=MP4).status_code == 429
        assert other.get("/videos").status_code == 200
        assert other.upload().status_code == 202
    until(lambda: one.get("/videos").status_code == 200)
    assert narrow.client.get(download).status_code == 200
    assert [one.get("/videos").status_code for _ in range(6)] == [200] * 6  # each leaves its place


def test_who_has_a_link_leaves_its_owner_work_and_the_end_of_it(wide: Api) -> None:
    one = holder(wide)
    links = [one.post("/uploads/link", json={}).json()["url"] for _ in range(6)]

    def send(method: str, path: str, key: Holder | None = None) -> None:
        before = len(wide.drafts)
        send_slowly(wide, stack, method, path, key)
        until(lambda: len(wide.drafts) == before + 1)

    with ExitStack() as stack:
        for number, link in enumerate(links[:4]):
            for _ in range(2):
                send("PUT", link)
            refused = wide.client.get(link)  # an eighth of them
            assert (refused.status_code, refused.json()["limit"]) == (429, 8 if number == 3 else 2)
        refused = wide.client.get(links[4])  # half of them
        assert (refused.status_code, refused.json()["limit"]) == (429, 8)
        for _ in range(7):
            send("POST", "/videos", one)
        assert one.delete(links[0].partition("?")[0]).status_code == 204
        send("POST", "/videos", one)
        assert one.get("/usage").json()["limit"] == 16  # of all, those by links too
    until(lambda: wide.client.get(links[4]).status_code == 200)
    assert [wide.client.get(links[5]).status_code for _ in range(9)] == [200] * 9  # each leaves its places


def test_without_keys_nothing_is_counted(narrow: Api) -> None:
    with ExitStack() as stack:
        for _ in range(6):
            send_slowly(narrow, stack, "POST", "/videos")
        until(lambda: len(narrow.drafts) == 6)
        assert narrow.client.get("/videos").status_code == 200
