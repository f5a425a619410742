"""What is on its way counts in a key's quota: by several requests at a time, of no declared length, before a body."""

from __future__ import annotations

import asyncio
import os
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import httpx
import pytest
from sqlalchemy.orm import Session

from service.api import draining, quotas
from service.api.arriving import Arriving, Share
from service.catalog import amounts
from service.catalog.keys import Limits
from service.errors import QuotaExceededError
from tests.service.api.test_authentication import Bearer, Holder, holder
from tests.service.fixtures import MP4, PNG, Api
from tests.waiting import until

QUOTA = 3_000_000
FILE = 2_000_000
CHUNK = 100_000
#: what is written at a time; buffers of connections hold less
PIECE = 2**20


@pytest.fixture
def limited(api: Api) -> Holder:
    return holder(api, Limits(stored_bytes=QUOTA))


def spooled(api: Api) -> int:
    size_bytes = 0
    for path in api.drafts:
        with suppress(FileNotFoundError):
            size_bytes += path.stat().st_size
    return size_bytes


class Slow:
    """A chunked body that stops before its end until it is told to go on."""

    def __init__(self, head: bytes = PNG, size: int = FILE) -> None:
        self.go_on = threading.Event()
        self._head, self._size = head, size

    def __iter__(self) -> Iterator[bytes]:
        yield self._head
        for _ in range(self._size // CHUNK):
            yield os.urandom(CHUNK)
        assert self.go_on.wait(60)
        yield b"the end"


@pytest.mark.parametrize("content_type", ["video/mp4", "multipart/form-data; boundary=x"])
def test_what_is_larger_than_any_file_is_told_so_and_not_to_wait_for_room(
    api: Api, limited: Holder, content_type: str
) -> None:
    for size, status in ((4_000_000, 429), (5_000_000_000, 413)):
        answer = answer_to_head(
            api, limited, f"POST /videos HTTP/1.1\r\nContent-Type: {content_type}\r\nContent-Length: {size}"
        )
        assert answer.startswith(f"HTTP/1.1 {status} ")


def test_a_body_of_json_that_is_too_large_is_not_asked_for(api: Api, limited: Holder) -> None:
    for size, line in ((2, "100 Continue"), (2**20 + 1, "413 ")):
        answer = answer_to_head(
            api, limited, f"POST /transfer HTTP/1.1\r\nContent-Type: application/json\r\nContent-Length: {size}"
        )
        assert answer.startswith(f"HTTP/1.1 {line}")


def answer_to_head(api: Api, caller: Holder, head: str) -> str:
    """The first line that comes to a client that waits before it sends a body."""
    with socket.create_connection(api.address, timeout=60) as connection:
        lines = (head, "Host: localhost", f"Authorization: Bearer {caller.text}", "Expect: 100-continue", "", "")
        connection.sendall("\r\n".join(lines).encode())
        return connection.recv(100).decode()


def test_two_files_that_fit_alone_and_not_together(api: Api, limited: Holder) -> None:
    first = Slow()
    with ThreadPoolExecutor() as clients:
        one = clients.submit(limited.post, "/references", content=iter(first))
        until(lambda: spooled(api) >= PIECE)
        refused = limited.post("/references", content=iter([PNG, *[os.urandom(CHUNK)] * 20]))
        assert (refused.status_code, refused.json()["code"]) == (429, "quota-exceeded")
        assert '"stored-bytes"' in refused.headers["ratelimit-policy"]
        # what says its length is refused before it comes
        assert limited.upload("/references", PNG + bytes(FILE)).status_code == 429
        # another key's are its own
        assert holder(api, Limits(stored_bytes=QUOTA)).upload("/references", PNG + bytes(FILE)).status_code == 202
        first.go_on.set()
        assert one.result(60).status_code == 202
    assert limited.upload("/references", PNG + bytes(FILE)).status_code == 429
    assert limited.upload("/references", PNG + bytes(FILE // 4)).status_code == 202
    assert api.drafts == []
    assert api.services.arriving._of == {}


def test_many_at_a_time_never_take_more_than_the_quota_and_what_each_just_sent(
    api: Api, limited: Holder, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies, seen, take = [Slow() for _ in range(8)], [0], Share.take

    async def noted(share: Share, size_bytes: int) -> None:
        await take(share, size_bytes)
        seen.append(share._account.size_bytes)

    monkeypatch.setattr(Share, "take", noted)
    with ThreadPoolExecutor(8) as clients:
        answers = [clients.submit(limited.post, "/references", content=iter(body)) for body in bodies]

        def are_refused() -> bool:
            account = api.services.arriving._of.get(limited.id)
            # the first request comes alone, too: the rest are refused once it was full
            return max(seen) > QUOTA // 2 and (account is None or account.places <= 1)

        until(are_refused, said=lambda: max(seen))
        assert max(seen) <= QUOTA
        assert spooled(api) <= QUOTA
        for body in bodies:
            body.go_on.set()
        assert sorted(one.result(60).status_code for one in answers)[1:] == [429] * 7


def head_alone(api: Api, request: str, key: str | None, length: int, kind: str) -> int:
    """The status of the answer to the head of a request whose body never comes."""
    lines = [f"{request} HTTP/1.1", "Host: localhost", f"Content-Length: {length}", f"Content-Type: {kind}"]
    lines += [f"Authorization: Bearer {key}"] if key else []
    with socket.create_connection(api.address, timeout=60) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(connection.recv(12).split()[1])


def test_what_says_that_it_is_too_large_is_refused_before_it_comes(
    api: Api, limited: Holder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draining, "DRAIN_S", 0.1)  # a body that is nearly over is waited for
    form = "multipart/form-data; boundary=x"
    for path in ("/transfer", "/transfer/form", "/references/form", "/videos/form"):
        assert head_alone(api, f"POST /v1{path}", limited.text, QUOTA + PIECE, form) == 429, path
    link = limited.post("/uploads/link", json={"role": "video"}).json()["url"]
    assert head_alone(api, f"PUT {link}", None, QUOTA + 1, "video/mp4") == 429


def test_an_announced_file_counts_once_and_what_was_sent_may_be_sent_again(api: Api, limited: Holder) -> None:
    file = MP4 + os.urandom(QUOTA - len(MP4))
    link = limited.post("/uploads/link", json={"role": "video"}).json()["url"]
    with httpx.Client(base_url=api.client.base_url, timeout=60) as stranger:
        for _ in range(2):  # the first answer may have been lost
            assert stranger.put(link, content=file, headers={"Content-Type": "video/mp4"}).status_code == 200
    again = {"Idempotency-Key": "once"}
    other = holder(api, Limits(stored_bytes=QUOTA))
    for _ in range(2):
        assert other.post("/videos", content=file, headers=again).status_code == 202
    third = holder(api, Limits(stored_bytes=QUOTA))
    tus = {"Tus-Resumable": "1.0.0"}
    place = third.post("/uploads", headers=tus | {"Upload-Length": str(QUOTA)}).headers["location"]
    piece = tus | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    with httpx.Client(base_url=api.client.base_url, timeout=60, auth=Bearer(third.text)) as client:
        assert client.patch(place, headers=piece, content=file).status_code == 204


def test_an_upload_goes_on_while_its_lost_connection_is_not_known_to_be_dead(api: Api, limited: Holder) -> None:
    file = MP4 + os.urandom(FILE - len(MP4))
    tus = {"Tus-Resumable": "1.0.0"}
    place = limited.post("/uploads", headers=tus | {"Upload-Length": str(FILE)}).headers["location"]
    piece = tus | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    head = [f"PATCH {httpx.URL(place).path} HTTP/1.1", "Host: localhost", f"Authorization: Bearer {limited.text}"]
    head += [f"{name}: {value}" for name, value in piece.items()]
    with socket.create_connection(api.address, timeout=60) as lost:
        lost.sendall("\r\n".join([*head, f"Content-Length: {FILE}", "", ""]).encode() + file[:CHUNK])
        until(lambda: limited.id in api.services.arriving._of)
        with httpx.Client(base_url=api.client.base_url, timeout=60, auth=Bearer(limited.text)) as client:
            assert client.patch(place, headers=piece, content=file).status_code == 204
    until(lambda: api.services.arriving._of == {})


def test_of_requests_for_one_announced_file_the_newest_alone_does_not_count(api: Api, limited: Holder) -> None:
    async def send() -> None:
        arriving = Arriving(api.services.calls, api.services.database)
        async with arriving.place(limited.id, free="upl") as former:
            await former.take(QUOTA)
            async with arriving.place(limited.id, free="upl") as newest:
                await newest.take(QUOTA)
                with pytest.raises(QuotaExceededError):
                    await former.take(QUOTA + 1)
        assert arriving._of == {}

    asyncio.run(send())


def test_who_comes_before_anything_is_known_waits_for_it(
    api: Api, limited: Holder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the database was slow to answer the first of several requests, the others were taken without a bound."""
    left, may_answer = quotas.left_bytes, threading.Event()

    def slow(session: Session, owner: str) -> int | None:
        assert may_answer.wait(60)
        return left(session, owner)

    monkeypatch.setattr(quotas, "left_bytes", slow)

    async def send() -> None:
        arriving = Arriving(api.services.calls, api.services.database)
        async with arriving.place(limited.id) as first, arriving.place(limited.id) as second:
            both = [asyncio.create_task(share.take(FILE)) for share in (first, second)]
            await asyncio.sleep(0.1)
            assert not any(one.done() for one in both)
            may_answer.set()
            await both[0]
            with pytest.raises(QuotaExceededError):
                await both[1]

    asyncio.run(send())


def test_what_is_recorded_of_a_request_arrives_no_longer(api: Api, limited: Holder) -> None:
    async def send() -> None:
        arriving = Arriving(api.services.calls, api.services.database)
        async with arriving.place(limited.id) as form, arriving.place(limited.id) as other:
            await form.take(QUOTA)
            form.give_back(FILE)
            await other.reserve(FILE)
            with pytest.raises(QuotaExceededError):
                await other.take(FILE + 1)
        assert arriving._of == {}

    asyncio.run(send())


def test_of_files_that_do_not_fit_together_the_first_are_taken(api: Api, limited: Holder) -> None:
    """They refused each other: all of them were sent in part, and none was kept, however often they were sent again."""
    files = [PNG + os.urandom(QUOTA // 3) for _ in range(6)]
    with ThreadPoolExecutor(6) as clients:
        answers = list(clients.map(lambda file: limited.upload("/references", file), files))
    assert sorted(one.status_code for one in answers) == [202, 202, 429, 429, 429, 429]
    assert api.services.arriving._of == {}


def test_what_is_too_much_only_with_what_arrives_may_be_sent_again_soon(api: Api, limited: Holder) -> None:
    async def send() -> None:
        arriving = Arriving(api.services.calls, api.services.database)
        async with arriving.place(limited.id) as first, arriving.place(limited.id) as second:
            await first.reserve(FILE)
            await first.take(FILE)  # what is announced counts once
            with pytest.raises(QuotaExceededError, match="on their way") as soon:
                await second.reserve(FILE)
            assert soon.value.headers["Retry-After"] == "5"
            with pytest.raises(QuotaExceededError, match="delete some") as late:
                await second.reserve(QUOTA + 1)
            assert late.value.headers["Retry-After"] == "86400"
            first.give_back()
            await second.reserve(QUOTA)
        assert arriving._of == {}

    asyncio.run(send())


def test_jobs_that_follow_each_other_count_what_a_key_keeps_once(
    api: Api, limited: Holder, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[str] = []

    def count(session: Session, owner: str) -> int:
        counted.append(owner)
        return len(counted) * QUOTA

    medium = limited.upload().json()["id"]
    monkeypatch.setattr(amounts, "stored_bytes", count)
    api.services.lately.note(limited.id, QUOTA)

    def ask(seed: int) -> int:
        body = {"video": medium, "looks": [{"reference": medium, "seed": seed}]}
        return limited.post("/transfer", json=body).status_code

    assert [ask(1), ask(2), counted] == [202, 202, []]
    api.services.lately.note(limited.id, QUOTA + 1)  # too much is looked at again
    assert [ask(3), counted] == [202, [limited.id]]
    monkeypatch.setattr(quotas, "_LATELY_S", 0.0)
    assert [ask(4), counted] == [429, [limited.id] * 2]
