from __future__ import annotations

import base64
import hashlib
import io
import json
import logging
import os
import random
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import select
from starlette.concurrency import run_in_threadpool
from tusclient.client import TusClient
from uvicorn.protocols.http.flow_control import HIGH_WATER_LIMIT

from service.api import quotas
from service.api.calls import Calls
from service.api.commands import pieces, resuming
from service.api.connections import BoundedProtocol
from service.api.services import Services
from service.catalog import keys, resumable, utc_now
from service.catalog.models import IdempotentRequest
from service.settings import Settings
from service.storage import Storage
from tests.service.api.test_authentication import Bearer, holder
from tests.service.fixtures import MP4, PNG, Api, begun, serve
from tests.service.s3 import S3
from tests.waiting import until

TUS = {"Tus-Resumable": "1.0.0"}
PIECE = TUS | {"Content-Type": "application/offset+octet-stream"}


def said(**values: str) -> str:
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in values.items())


def content(size: int = 300_000) -> bytes:
    return MP4 + random.Random(size).randbytes(size - len(MP4))


def begin(client: httpx.Client, size: int, **more: str) -> str:
    made = client.post("/uploads", headers=TUS | {"Upload-Length": str(size), "Upload-Metadata": said(**more)})
    assert made.status_code == 201, made.text
    assert made.headers["tus-resumable"] == "1.0.0"
    return made.headers["location"]


def send(client: httpx.Client, url: str, offset: int, data: bytes, **more: str) -> httpx.Response:
    return client.patch(url, content=data, headers=PIECE | {"Upload-Offset": str(offset)} | more)


def offset_of(client: httpx.Client, url: str) -> int:
    found = client.head(url, headers=TUS)
    assert found.status_code == 200
    assert found.headers["cache-control"] == "no-store"
    return int(found.headers["upload-offset"])


def test_the_service_says_what_of_tus_it_speaks(api: Api) -> None:
    answer = api.client.options("/uploads")
    assert answer.status_code == 204
    assert answer.headers["tus-version"] == "1.0.0"
    assert set(answer.headers["tus-extension"].split(",")) == {"creation", "termination", "expiration", "checksum"}
    assert answer.headers["tus-max-size"] == str(api.services.settings.max_upload_bytes)
    assert answer.headers["tus-checksum-algorithm"] == "sha256,sha1"
    assert "content-type" not in answer.headers


def test_a_file_in_pieces_is_the_medium_that_it_is_whole(api: Api) -> None:
    data = content()
    url = begin(api.client, len(data), filename="my clip.mp4", mask="ycbcr", **{"metadata.order": "42"})
    assert (offset_of(api.client, url), api.blobs) == (0, [])
    for start in (0, 100_000, 200_000):
        answer = send(api.client, url, start, data[start : start + 100_000])
        assert answer.status_code == 204, answer.text
        assert answer.headers["upload-offset"] == str(start + 100_000)
    video = api.client.get(f"/videos/{answer.headers['pvg-media']}").json()
    assert video["sha256"] == hashlib.sha256(data).hexdigest()
    assert (video["filename"], video["content_type"], video["size_bytes"]) == ("my clip.mp4", "video/mp4", len(data))
    assert video["settings"]["mask"] == "ycbcr"
    assert video["metadata"] == {"order": "42"}
    shown = api.client.get(url).json()
    assert (shown["media"], shown["offset_bytes"], shown["size_bytes"]) == (video["id"], len(data), len(data))
    head = api.client.head(url, headers=TUS).headers
    assert (head["upload-offset"], head["upload-length"], head["pvg-media"]) == (str(len(data)),) * 2 + (video["id"],)
    # the pieces are gone, the file is there once
    api.services.reaper.delete()
    assert [key.partition("/")[0] for key in api.blobs] == ["source"]
    assert api.drafts == []
    whole = api.client.post("/videos?mask=ycbcr", content=data)
    assert (whole.status_code, whole.json()["id"]) == (200, video["id"])


def test_a_reference_in_one_piece(api: Api) -> None:
    data = PNG + b"a" * 1000
    url = begin(api.client, len(data), role="reference", name="face.png", type="image/png", relativePath="null")
    answer = send(api.client, url, 0, data)
    assert answer.headers["pvg-media"].startswith("ref_")
    assert api.client.get(f"/references/{answer.headers['pvg-media']}").json()["filename"] == "face.png"
    # the record of the upload goes with the medium
    assert api.client.delete(f"/references/{answer.headers['pvg-media']}?cancel_jobs=true").status_code == 204
    assert api.client.get(url).status_code == 404


def test_the_next_piece_may_go_to_another_api(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", reap_interval_s=3600)
    data = content()
    first, second = serve(settings), serve(settings)
    one, two = next(first), next(second)
    url = begin(one.client, len(data))
    for number, start in enumerate(range(0, len(data), 100_000)):
        answer = send((two, one)[number % 2].client, url, start, data[start : start + 100_000])
        assert answer.status_code == 204
    assert two.client.get(f"/videos/{answer.headers['pvg-media']}").json()["sha256"] == hashlib.sha256(data).hexdigest()
    for end in (first, second):
        next(end, None)


def test_pieces_in_an_object_store(tmp_path: Path, bucket: S3) -> None:
    settings = Settings(data_dir=tmp_path / "data", reap_interval_s=3600, storage_url=bucket.storage_url)
    data = content()
    for api in serve(settings):
        url = begin(api.client, len(data))
        send(api.client, url, 0, data[:100_000])
        assert [key.split("/")[0] for key in api.blobs] == ["part"]
        answer = send(api.client, url, 100_000, data[100_000:])
        video = api.client.get(f"/videos/{answer.headers['pvg-media']}").json()
        assert video["sha256"] == hashlib.sha256(data).hexdigest()
        api.services.reaper.delete()
        assert [key.split("/")[0] for key in api.blobs] == ["source"]


def test_an_upload_has_no_more_pieces_than_there_may_be(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "MAX_PARTS", 3)
    data = content()
    url = begin(api.client, len(data))
    for start in (0, 100, 200):
        assert send(api.client, url, start, data[start : start + 100]).status_code == 204
    kept = api.blobs
    answer = send(api.client, url, 300, data[300:400])
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert "has 3 pieces, the most there may be" in answer.json()["detail"]
    assert (offset_of(api.client, url), api.blobs, api.drafts) == (300, kept, [])


def test_bytes_that_are_not_the_next_ones_are_refused(api: Api) -> None:
    url = begin(api.client, 300_000)
    assert send(api.client, url, 5, b"x").status_code == 409
    assert send(api.client, url, 0, MP4).status_code == 204
    again = send(api.client, url, 0, MP4)
    assert (again.status_code, again.headers["tus-resumable"]) == (409, "1.0.0")
    assert offset_of(api.client, url) == len(MP4)
    assert len(api.blobs) == 1


def test_of_two_pieces_for_the_same_bytes_one_is_kept(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    url = begin(api.client, 300_000)
    # the other one arrives while this one is about to be stored
    storage = api.services.storage
    monkeypatch.setattr(storage, "put", _before(storage.put, lambda: send(api.client, url, 0, MP4)))
    assert send(api.client, url, 0, MP4 + b"second").status_code == 409
    assert offset_of(api.client, url) == len(MP4)
    api.services.reaper.delete()
    assert len(api.blobs) == 1


@pytest.mark.parametrize("when", ["before the others are looked for", "while they are read"])
def test_a_last_piece_that_is_sent_twice_at_a_time_takes_nothing_away(
    api: Api, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = content()
    url = begin(api.client, len(data))
    assert send(api.client, url, 0, data[:200_000]).status_code == 204
    last = partial(send, api.client, url, 200_000, data[200_000:])
    if when == "while they are read":
        real = _before(lambda: None, last)

        async def stream(*args: Any) -> Any:
            await run_in_threadpool(real)
            await run_in_threadpool(api.services.reaper.delete)
            return await Storage.stream(api.services.storage, *args)

        monkeypatch.setattr(api.services.storage, "stream", stream)
        late = last()
    else:
        halves = _interrupted(api, data[200_000:], last)
        late = api.client.patch(url, content=halves, headers=PIECE | {"Upload-Offset": "200000"})
    assert (late.status_code, late.json()["code"]) == (409, "conflict")
    assert offset_of(api.client, url) == len(data)
    media_id = api.client.get(url).json()["media"]
    assert api.client.get(f"/videos/{media_id}").json()["sha256"] == hashlib.sha256(data).hexdigest()


def test_what_is_no_film_takes_no_upload_away_that_another_request_has_completed(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = content()
    url = begin(api.client, len(data))
    other = _before(lambda: None, lambda: send(api.client, url, 0, data))

    async def write(*args: Any, **more: Any) -> Any:
        await run_in_threadpool(other)
        return await Calls.write(api.services.calls, *args, **more)

    monkeypatch.setattr(api.services.calls, "write", write)
    assert send(api.client, url, 0, b"x" * len(data)).status_code == 409
    assert api.client.get(url).json()["media"]


def _before(call: Any, other: Any) -> Any:
    done: list[int] = []

    def both(*args: Any, **more: Any) -> Any:
        if not done:
            done.append(1)
            assert other().status_code == 204
        return call(*args, **more)

    return both


def _interrupted(api: Api, data: bytes, other: Callable[[], httpx.Response]) -> Iterator[bytes]:
    """A body during which another request is answered."""
    yield data[:1000]
    until(lambda: api.drafts)
    assert other().status_code == 204
    yield data[1000:]


@pytest.mark.parametrize("algorithm", ["sha256", "sha1"])
def test_a_piece_that_was_damaged_is_not_kept(api: Api, algorithm: str) -> None:
    data = content()
    url = begin(api.client, len(data))

    def digest(of: bytes) -> str:
        return f"{algorithm} {base64.b64encode(hashlib.new(algorithm, of).digest()).decode()}"

    damaged = send(api.client, url, 0, data[:1000], **{"Upload-Checksum": digest(b"another")})
    assert (damaged.status_code, damaged.json()["code"]) == (460, "checksum-mismatch")
    assert (offset_of(api.client, url), api.blobs, api.drafts) == (0, [], [])
    assert send(api.client, url, 0, data[:1000], **{"Upload-Checksum": digest(data[:1000])}).status_code == 204
    damaged = send(api.client, url, 1000, data[1000:], **{"Upload-Checksum": digest(data)})
    assert damaged.status_code == 460
    last = send(api.client, url, 1000, data[1000:], **{"Upload-Checksum": digest(data[1000:])})
    assert last.headers["pvg-media"]
    for wrong in ("md5 abc=", "sha256 %%%", "sha256"):
        other = begin(api.client, len(data))
        assert send(api.client, other, 0, MP4, **{"Upload-Checksum": wrong}).status_code in {400, 460}


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 412),
        (TUS, 400),
        (TUS | {"Upload-Length": "-1"}, 400),
        (TUS | {"Upload-Length": "9" * 30}, 400),
        (TUS | {"Upload-Length": "0"}, 415),
        (TUS | {"Upload-Length": "3000000000"}, 413),
        (TUS | {"Upload-Length": "10", "Upload-Metadata": "filename %%%"}, 400),
        (TUS | {"Upload-Length": "10", "Upload-Metadata": "a YQ==,a YQ=="}, 400),
        (TUS | {"Upload-Length": "10", "Upload-Metadata": said(role="both")}, 422),
        (TUS | {"Upload-Length": "10", "Upload-Metadata": said(speed="1")}, 422),
        (TUS | {"Upload-Length": "10", "Upload-Metadata": said(role="reference", matching="chain")}, 422),
        ({"Tus-Resumable": "0.2.2", "Upload-Length": "10"}, 412),
    ],
)
def test_an_upload_that_cannot_be_is_refused_at_once(api: Api, headers: dict[str, str], status: int) -> None:
    refused = api.client.post("/uploads", headers=headers)
    assert refused.status_code == status, refused.text
    assert refused.headers["tus-resumable"] == "1.0.0"


def test_a_length_that_is_missing_is_asked_for(api: Api) -> None:
    """As of who would say it later, which is another extension of tus."""
    refused = api.client.post("/uploads", headers=TUS | {"Upload-Defer-Length": "1"})
    assert (refused.status_code, refused.json()["detail"]) == (400, "send Upload-Length, a number of bytes")


@pytest.mark.parametrize("concat", ["partial", "final;/v1/uploads/a /v1/uploads/b"])
def test_a_part_of_uploads_that_shall_be_joined_is_no_file(api: Api, concat: str) -> None:
    """tus-js-client sends such parts, without asking, with `parallelUploads`: the first one became a medium."""
    link = api.client.post("/uploads/link", json={}).json()["url"]
    for url in ("/uploads", link):
        refused = api.client.post(url, headers=TUS | {"Upload-Length": "10", "Upload-Concat": concat})
        assert (refused.status_code, refused.json()["code"]) == (400, "malformed")
        assert "Upload-Concat is not supported" in refused.json()["detail"]
    assert [upload["size_bytes"] for upload in api.client.get("/uploads").json()["data"]] == [None]


def test_a_length_that_is_said_and_shall_be_said_later_is_refused(api: Api) -> None:
    """The field is left out where the length is known (tus 1.0, Upload-Defer-Length); others answer 400, too."""
    link = api.client.post("/uploads/link", json={}).json()["url"]
    for url in ("/uploads", link):
        refused = api.client.post(url, headers=TUS | {"Upload-Length": "10", "Upload-Defer-Length": "1"})
        assert (refused.status_code, refused.json()["code"]) == (400, "malformed")
        assert refused.json()["detail"].startswith("send Upload-Length alone")
    assert [upload["size_bytes"] for upload in api.client.get("/uploads").json()["data"]] == [None]


def test_an_upload_takes_all_the_metadata_that_a_file_may_have(api: Api) -> None:
    metadata = {f"metadata.{number:02}{'n' * 38}": f"{number:02}{'v' * 198}" for number in range(16)}
    media = send(api.client, begin(api.client, len(MP4), **metadata), 0, MP4).headers["pvg-media"]
    shown = api.client.get(f"/videos/{media}").json()["metadata"]
    assert {f"metadata.{name}": value for name, value in shown.items()} == metadata
    longer = TUS | {"Upload-Length": "10", "Upload-Metadata": said(filename="n" * 8000)}
    assert api.client.post("/uploads", headers=longer).status_code == 400


def test_pieces_keep_to_the_protocol(api: Api) -> None:
    url = begin(api.client, 1000)
    at = {"Upload-Offset": "0"}
    assert api.client.patch(url, content=b"x", headers=at).status_code == 412
    assert api.client.patch(url, content=b"x", headers=TUS | at).status_code == 415
    assert api.client.patch(url, content=b"x", headers=PIECE).status_code == 400
    assert send(api.client, url, 0, b"x" * 1001).status_code == 413
    lying = api.client.patch(url, content=iter([b"x" * 600, b"x" * 600]), headers=PIECE | at)
    assert lying.status_code == 413
    assert offset_of(api.client, url) == 0
    assert send(api.client, url, 0, b"").status_code == 204
    assert api.client.head("/uploads/upl_0", headers=TUS).status_code == 404
    by_post = api.client.post(url, content=MP4, headers=PIECE | at | {"X-HTTP-Method-Override": "PATCH"})
    assert (by_post.status_code, by_post.headers["upload-offset"]) == (204, str(len(MP4)))
    assert api.drafts == []


def test_a_file_that_is_longer_than_announced_is_told_what_was_announced(api: Api) -> None:
    url = begin(api.client, 1000)
    assert send(api.client, url, 0, b"x" * 600).status_code == 204
    declared = send(api.client, url, 600, b"x" * 401)
    lying = api.client.patch(url, content=iter([b"x" * 300, b"x" * 200]), headers=PIECE | {"Upload-Offset": "600"})
    for longer in (declared, lying):
        told = "more bytes came than the 1000 that Upload-Length announced", 1000
        assert (longer.status_code, longer.json()["detail"], longer.json()["limit"]) == (413, *told)
    assert offset_of(api.client, url) == 600


def test_what_is_no_film_is_refused_at_its_end_and_nothing_is_kept(api: Api) -> None:
    url = begin(api.client, 2000)
    assert send(api.client, url, 0, b"<html>" + b"x" * 994).status_code == 204
    assert send(api.client, url, 1000, b"x" * 1000).status_code == 415
    assert api.client.head(url, headers=TUS).status_code == 404
    assert (api.blobs, api.drafts) == ([], [])


def test_what_is_no_film_is_refused_after_its_first_piece_where_that_shows_it(api: Api) -> None:
    url = begin(api.client, 1_000_000)
    refused = send(api.client, url, 0, b"<html>" + b"x" * 5000)
    assert (refused.status_code, refused.json()["code"]) == (415, "unsupported-media-type")
    assert api.client.head(url, headers=TUS).status_code == 404
    assert (api.blobs, api.drafts) == ([], [])


@pytest.mark.parametrize("checksum", [False, True])
def test_what_is_no_film_is_refused_after_its_first_bytes_unless_they_may_be_damaged(api: Api, checksum: bool) -> None:
    url = begin(api.client, 1_000_000_000)
    fields = PIECE | {"Upload-Offset": "0"} | ({"Upload-Checksum": "sha1 AAAA"} if checksum else {})
    status = begun(
        api, f"PATCH {url}", b"<html>" + b"x" * 5000, 1_000_000_000, within_s=3 if checksum else 60, **fields
    )
    assert status == (None if checksum else 415)
    assert api.client.head(url, headers=TUS).status_code == (200 if checksum else 404)
    until(lambda: (api.blobs, api.drafts) == ([], []))


def test_a_checksum_that_is_no_base64_is_malformed(api: Api) -> None:
    url, fields = begin(api.client, len(MP4)), PIECE | {"Upload-Offset": "0"}
    for digest in ("AAA", "AA=A", "***", b"sha1 \xe9"):
        header = digest if isinstance(digest, bytes) else f"sha1 {digest}".encode()
        refused = api.client.patch(url, content=MP4, headers=[*fields.items(), ("Upload-Checksum", header)])
        assert (refused.status_code, refused.json()["code"]) == (400, "malformed"), digest


def test_damaged_first_bytes_take_no_upload_away(api: Api) -> None:
    url = begin(api.client, 1_000_000)
    digest = base64.b64encode(hashlib.sha1(content()).digest()).decode()
    refused = send(api.client, url, 0, b"\0" * 300_000, **{"Upload-Checksum": f"sha1 {digest}"})
    assert refused.status_code == 460
    assert send(api.client, url, 0, content(), **{"Upload-Checksum": f"sha1 {digest}"}).status_code == 204


def test_first_bytes_of_no_film_take_away_nothing_that_another_request_has_sent(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = content()
    url = begin(api.client, len(data))
    other = _before(lambda: None, lambda: send(api.client, url, 0, data[:200_000]))

    async def write(*args: Any, **more: Any) -> Any:
        await run_in_threadpool(other)
        return await Calls.write(api.services.calls, *args, **more)

    monkeypatch.setattr(api.services.calls, "write", write)
    assert send(api.client, url, 0, b"x" * len(data)).status_code == 409
    assert offset_of(api.client, url) == 200_000


@pytest.mark.parametrize("size", [30_000, 200_000])
def test_all_that_came_before_the_connection_broke_is_kept(
    api: Api, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also what had come, but was not read, when it broke: here nothing is read of what can wait in memory."""
    lost = threading.Event()
    find, lose = resuming.find_in, BoundedProtocol.connection_lost

    def find_late(*args: Any) -> Any:
        assert size > HIGH_WATER_LIMIT or lost.wait(60)
        return find(*args)

    def noted(self: BoundedProtocol, error: Exception | None) -> None:
        lose(self, error)
        lost.set()

    monkeypatch.setattr(resuming, "find_in", find_late)
    monkeypatch.setattr(BoundedProtocol, "connection_lost", noted)
    data = content()
    url = begin(api.client, len(data))
    head = f"PATCH {url} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {len(data)}\r\nUpload-Offset: 0\r\n"
    head += "".join(f"{name}: {value}\r\n" for name, value in PIECE.items())
    with socket.create_connection(api.address) as connection:
        connection.sendall(head.encode() + b"\r\n" + data[:size])
    assert until(lambda: offset_of(api.client, url)) == size
    answer = send(api.client, url, size, data[size:])
    video = api.client.get(f"/videos/{answer.headers['pvg-media']}").json()
    assert video["sha256"] == hashlib.sha256(data).hexdigest()


def test_a_long_piece_is_stored_as_it_comes(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "PART_BYTES", 100_000)
    drafts: list[int] = []
    blobs = api.services.blobs
    real = blobs.expect

    def counted(key: str) -> None:
        drafts.append(len(api.drafts))
        real(key)

    monkeypatch.setattr(blobs, "expect", counted)
    data = content(3_000_000)  # what is read at once is a part, however much of it has come
    url = begin(api.client, len(data) + 1)
    assert send(api.client, url, 0, data).status_code == 204
    assert len(api.blobs) >= 5
    # a part that is stored takes no room in the spool any more
    assert set(drafts) == {1}
    answer = send(api.client, url, len(data), b"x")
    video = api.client.get(f"/videos/{answer.headers['pvg-media']}").json()
    assert video["sha256"] == hashlib.sha256(data + b"x").hexdigest()


def test_when_the_last_piece_fails_it_may_be_sent_again(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    data = content()
    url = begin(api.client, len(data))
    send(api.client, url, 0, data[:100_000])
    real = resumable.close

    def broken(*args: Any, **more: Any) -> None:
        raise RuntimeError("no power")

    monkeypatch.setattr(resumable, "close", broken)
    assert send(api.client, url, 100_000, data[100_000:]).status_code == 500
    monkeypatch.setattr(resumable, "close", real)
    assert offset_of(api.client, url) == 100_000
    assert send(api.client, url, 100_000, data[100_000:]).headers["pvg-media"]
    api.services.reaper.delete()
    assert [key.partition("/")[0] for key in api.blobs] == ["source"]


def test_a_terminated_upload_is_gone(api: Api) -> None:
    url = begin(api.client, 300_000)
    send(api.client, url, 0, MP4)
    assert api.client.delete(url, headers=TUS).status_code == 204
    until(lambda: api.blobs == [])
    assert api.client.head(url, headers=TUS).status_code == 404
    assert api.client.delete(url, headers=TUS).status_code == 404


@pytest.mark.parametrize("key", [None, "order-42"])
def test_an_upload_whose_client_goes_before_it_is_told_of_it_is_not_kept_unless_it_may_ask_again(
    api: Api, key: str | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    begins, lost = threading.Event(), threading.Event()
    real, lose = resumable.create, BoundedProtocol.connection_lost

    def create(*args: Any, **more: Any) -> Any:
        begins.set()
        assert lost.wait(60)
        return real(*args, **more)

    def noted(self: BoundedProtocol, error: Exception | None) -> None:
        lose(self, error)
        lost.set()

    monkeypatch.setattr(resumable, "create", create)
    monkeypatch.setattr(BoundedProtocol, "connection_lost", noted)
    fields = {"Host": "localhost", "Upload-Length": "1000"} | TUS | ({"Idempotency-Key": key} if key else {})
    lines = "".join(f"{name}: {value}\r\n" for name, value in fields.items())
    with caplog.at_level(logging.INFO), socket.create_connection(api.address) as connection:
        connection.sendall(f"POST /uploads HTTP/1.1\r\n{lines}\r\n".encode())
        assert begins.wait(60)
    with caplog.at_level(logging.INFO):
        until(lambda: any(record.msg in {"client went away", "request"} for record in caplog.records))
    assert len(api.client.get("/uploads").json()["data"]) == (0 if key is None else 1)


def test_an_upload_that_is_not_gone_on_with_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for api in serve(Settings(data_dir=tmp_path / "data", reap_interval_s=3600, upload_ttl_s=1000)):
        url = begin(api.client, 300_000)
        answer = send(api.client, url, 0, MP4)
        assert answer.headers["upload-expires"].endswith("GMT")
        # a search for files without a record keeps what a record names
        api.services.collector.collect()
        api.services.reaper.delete()
        assert len(api.blobs) == 1
        for database in (api.services.database, api.services.background):
            monkeypatch.setattr(database, "now", lambda: utc_now() + timedelta(seconds=1001))
        assert send(api.client, url, len(MP4), b"x").status_code == 404
        api.services.reaper.expire()
        api.services.reaper.delete()
        assert api.blobs == []


def test_a_piece_has_its_upload_outlive_its_time_and_none_that_follows_at_once_writes_for_that(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    url, data = begin(api.client, 3000), content(3000)
    kept: list[str] = []
    keep = resuming.keep

    def counted(services: Services, upload_id: str) -> None:
        kept.append(upload_id)
        keep(services, upload_id)

    monkeypatch.setattr(pieces, "keep", counted)
    assert send(api.client, url, 0, data[:1000]).status_code == 204
    assert kept == []
    for hours in (23, 46):  # the second is after the time that the first piece left it
        monkeypatch.setattr(api.services.database, "now", lambda hours=hours: utc_now() + timedelta(hours=hours))
        start = 1000 * len(kept) + 1000
        assert send(api.client, url, start, data[start : start + 1000]).status_code == 204
    assert len(kept) == 2


def test_an_upload_is_its_keys_own_and_counts_in_its_quota(api: Api) -> None:
    made = {}
    with api.services.background.write() as session:
        now = api.services.database.now()
        for name in ("studio", "other"):
            limits = keys.Limits(requests_per_minute=600, active_jobs=10, stored_bytes=1_000_000)
            made[name] = {"Authorization": f"Bearer {keys.create(session, name, limits, now=now)[1]}"}
    studio, other = (httpx.Client(base_url=api.client.base_url, headers=one, timeout=60) for one in made.values())
    with studio, other:
        assert api.client.post("/uploads", headers=TUS | {"Upload-Length": "10"}).status_code == 401
        removed = begin(studio, 10)
        for answer in (
            studio.head(removed, headers=TUS),
            send(studio, removed, 0, b"x"),
            studio.delete(removed, headers=TUS),
        ):
            assert (answer.is_success, answer.headers["tus-resumable"]) == (True, "1.0.0")
            assert "requests" in answer.headers["ratelimit"]
        url = begin(studio, 600_000)
        assert other.head(url, headers=TUS).status_code == 404
        assert send(other, url, 0, MP4).status_code == 404
        assert other.delete(url, headers=TUS).status_code == 404
        second = studio.post("/uploads", headers=TUS | {"Upload-Length": "600000"})
        assert (second.status_code, second.json()["code"]) == (429, "quota-exceeded")
        # what was reserved is what it takes, and not twice
        data = content(600_000)
        assert send(studio, url, 0, data[:300_000]).status_code == 204
        assert send(studio, url, 300_000, data[300_000:]).headers["pvg-media"]
        assert begin(studio, 399_000)


def test_a_small_piece_counts_as_what_it_takes_on_the_disk(api: Api) -> None:
    key = holder(api, keys.Limits(stored_bytes=30_000))
    with httpx.Client(base_url=api.client.base_url, auth=Bearer(key.text), timeout=60) as client:

        def used() -> int:
            return int(client.get("/usage").json()["stored_bytes"]["used"])

        data = content(20_000)
        url = begin(client, len(data))
        for start in (0, 1):
            assert used() == 20_000 + start * 4095
            assert send(client, url, start, data[start : start + 1]).status_code == 204
        refused = send(client, url, 2, data[2:3])
        assert (refused.status_code, refused.json()["unit"], offset_of(client, url)) == (429, "bytes", 2)
        assert api.drafts == []
        for start, end in ((2, 8_000), (8_000, 20_000)):  # these take no more than they are
            assert send(client, url, start, data[start:end]).status_code == 204
        assert used() == 20_000


def test_an_upload_that_is_begun_again_by_its_key_is_told_of_with_all_its_fields(api: Api) -> None:
    headers = TUS | {"Upload-Length": "10", "Idempotency-Key": "a"}
    first, second = (api.client.post("/uploads", headers=headers) for _ in range(2))
    passing = {"date", "x-request-id", "idempotent-replayed", "cache-control"}
    kept = [{name: value for name, value in one.headers.items() if name not in passing} for one in (first, second)]
    assert kept[0] == kept[1]
    assert {"location", "upload-expires", "tus-resumable"} <= kept[1].keys()


def test_an_upload_is_begun_once_for_an_idempotency_key(api: Api) -> None:
    headers = TUS | {"Upload-Length": "10", "Idempotency-Key": "a"}
    first, second = (api.client.post("/uploads", headers=headers) for _ in range(2))
    assert second.headers["location"] == first.headers["location"]
    assert second.headers["idempotent-replayed"] == "true"


@pytest.mark.parametrize("end", ["the medium is deleted", "the upload is removed"])
def test_no_kept_answer_has_the_name_of_a_file_that_is_deleted(api: Api, end: str) -> None:
    data = PNG + b"a" * 1000
    about = said(role="reference", filename="someone.png")
    headers = TUS | {"Upload-Length": str(len(data)), "Upload-Metadata": about, "Idempotency-Key": "a"}
    url = api.client.post("/uploads", headers=headers).headers["location"]
    if end == "the upload is removed":
        assert api.client.delete(url, headers=TUS).status_code == 204
    else:
        medium = send(api.client, url, 0, data).headers["pvg-media"]
        assert api.client.delete(f"/references/{medium}?cancel_jobs=true").status_code == 204
    with api.services.database.read() as session:
        assert session.scalars(select(IdempotentRequest)).all() == []
    assert api.client.post("/uploads", headers=headers).headers["location"] != url


def test_uploads_that_are_not_complete_are_so_many_at_most(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quotas, "MAX_OPEN_UPLOADS", 2)
    data = PNG + b"a" * 100
    first = begin(api.client, len(data), role="reference")
    api.client.post("/uploads/link", json={"role": "video"}).raise_for_status()
    for refused in (
        api.client.post("/uploads", headers=TUS | {"Upload-Length": "10"}),
        api.client.post("/uploads/link", json={"role": "video"}),
    ):
        assert (refused.status_code, refused.json()["code"]) == (429, "quota-exceeded")
        assert (refused.json()["limit"], refused.json()["unit"]) == (2, "uploads")
        assert int(refused.headers["retry-after"]) > 0
    assert send(api.client, first, 0, data).status_code == 204
    second = begin(api.client, 10)
    assert api.client.delete(second, headers=TUS).status_code == 204
    begin(api.client, 10)


# clients of others


def test_tuspy_uploads_and_resumes(api: Api) -> None:
    client = TusClient(f"{api.client.base_url}/uploads")
    data = content(1_000_000)
    first = client.uploader(file_stream=io.BytesIO(data), chunk_size=300_000, metadata={"filename": "a.mp4"})
    first.upload(stop_at=300_000)
    second = client.uploader(
        file_stream=io.BytesIO(data), url=first.url, chunk_size=400_000, upload_checksum=True, metadata={}
    )
    second.upload()
    shown = api.client.get(first.url).json()
    assert api.client.get(f"/videos/{shown['media']}").json()["sha256"] == hashlib.sha256(data).hexdigest()


@pytest.fixture
def tus_js(monkeypatch: pytest.MonkeyPatch) -> str:
    """node, where it finds tus-js-client: below the folder that TUS_JS_CLIENT names."""
    node, folder = shutil.which("node"), os.environ.get("TUS_JS_CLIENT", "")
    if node is None or not (Path(folder) / "node_modules" / "tus-js-client").is_dir():
        pytest.skip("node is not installed, or TUS_JS_CLIENT names no folder where npm installed tus-js-client")
    return node


def _by_node(node: str, *arguments: str) -> dict[str, Any]:
    script = Path(__file__).parent / "node" / "upload.mjs"
    done = subprocess.run([node, str(script), *arguments], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize(("chunk", "break_at"), [("Infinity", []), ("300000", []), ("300000", ["300000"])])
def test_tus_js_client_uploads_and_resumes(
    api: Api, tus_js: str, tmp_path: Path, chunk: str, break_at: list[str]
) -> None:
    data = content(1_000_000)
    (tmp_path / "a.mp4").write_bytes(data)
    said = json.dumps({"filename": "ä.mp4", "filetype": "video/mp4"})
    found = _by_node(tus_js, f"{api.client.base_url}/uploads", str(tmp_path / "a.mp4"), said, chunk, *break_at)
    video = api.client.get(f"/videos/{found['media']}").json()
    assert (video["sha256"], video["filename"]) == (hashlib.sha256(data).hexdigest(), "ä.mp4")


def test_tus_js_client_uploads_by_a_link(api: Api, tus_js: str, tmp_path: Path) -> None:
    data = content(1_000_000)
    (tmp_path / "a.mp4").write_bytes(data)
    link = api.client.post("/uploads/link", json={"max_bytes": 2_000_000}).json()
    at = f"{str(api.client.base_url).rstrip('/')}{link['url']}"
    found = _by_node(tus_js, at, str(tmp_path / "a.mp4"), "{}", "300000", "300000")
    assert not found.get("media")  # that is for who made the link
    video = api.client.get(f"/uploads/{link['id']}").json()["media"]
    assert api.client.get(f"/videos/{video}").json()["sha256"] == hashlib.sha256(data).hexdigest()


def test_with_a_key_too_every_answer_of_tus_says_its_version(api: Api) -> None:
    key = holder(api, keys.Limits(requests_per_minute=10))
    said = {"Tus-Resumable": "1.0.0"}
    made = key.post("/v1/uploads", headers=said | {"Upload-Length": "20"})
    place = made.headers["location"]
    piece = said | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    answers = [made, *(key.send("PATCH", place, headers=piece, content=one) for one in (b"0123", b"4"))]
    assert [answer.status_code for answer in answers] == [201, 204, 409]
    for answer in answers:
        assert answer.headers["tus-resumable"] == "1.0.0"
        assert "ratelimit" in answer.headers
    paths = ("/v1/uploads", "/v1/uploads?x=1", place, "/uploads/link")
    refused = [api.client.request(method, path) for method in ("POST", "OPTIONS") for path in paths]
    refused = [answer for answer in refused if answer.status_code != 405]
    assert {answer.status_code for answer in refused} == {401}
    refused += [key.post("/v1/uploads?x=1", headers=said), key.send("OPTIONS", "/v1/uploads")]
    refused += [key.post("/v1/uploads", headers=said) for _ in range(20)]
    assert {answer.status_code for answer in refused} == {401, 422, 204, 400, 429}
    assert {answer.headers.get("tus-resumable") for answer in refused} == {"1.0.0"}


def test_who_has_lost_where_uploads_are_finds_them_in_a_list(api: Api) -> None:
    data = content()
    said_of_it = {
        "filename": "my clip.mp4",
        "mask": "ycbcr",
        "metadata.order": "42",
        "webhook": "https://a.example/?token=1",
    }
    url = begin(api.client, len(data), **said_of_it)
    assert send(api.client, url, 0, data[:100_000]).status_code == 204
    reference = begin(api.client, 10, role="reference")
    link = api.client.post("/uploads/link", json={"role": "reference", "max_bytes": 1000}).json()
    answer = api.client.get("/uploads")
    assert answer.headers["tus-resumable"] == "1.0.0"
    assert "token" not in answer.text  # as in GET of one, receivers are not shown
    assert link["url"].partition("signature=")[2] not in answer.text
    by_link, second, first = answer.json()["data"]
    assert answer.json()["next_cursor"] is None
    for one in (by_link, second, first):
        alone = api.client.get(one["url"]).json()
        assert {name: one[name] for name in alone} == alone
    assert (first["url"], first["role"], first["filename"]) == (url, "video", "my clip.mp4")
    assert (first["size_bytes"], first["offset_bytes"]) == (len(data), 100_000)
    assert (first["settings"]["mask"], first["metadata"]) == ("ycbcr", {"order": "42"})
    assert (second["url"], second["role"], second["metadata"]) == (reference, "reference", {})
    assert (by_link["id"], by_link["size_bytes"], by_link["offset_bytes"]) == (link["id"], None, 0)
    # what is found goes on, or is deleted; what has arrived is no upload any more
    assert send(api.client, first["url"], first["offset_bytes"], data[100_000:]).headers["pvg-media"]
    assert api.client.delete(second["url"]).status_code == 204
    assert [one["id"] for one in api.client.get("/uploads").json()["data"]] == [link["id"]]


def test_uploads_are_listed_in_pages_of_their_key_alone(api: Api) -> None:
    one, other = holder(api), holder(api)
    made = []
    for n in range(5):
        headers = TUS | {"Upload-Length": str(10 + n)}
        made.append(one.post("/uploads", headers=headers).json()["id"])
    others = other.post("/uploads", headers=TUS | {"Upload-Length": "10"}).json()["id"]
    found, cursor = [], ""
    for _ in range(3):
        page = one.get(f"/uploads?limit=2{cursor}").json()
        found.append([upload["id"] for upload in page["data"]])
        cursor = f"&cursor={page['next_cursor']}"
    assert found == [made[:2:-1], made[2:0:-1], made[:1]]
    assert cursor == "&cursor=None"
    assert [upload["id"] for upload in other.get("/uploads").json()["data"]] == [others]
    for wrong in ("cursor=vid_1", "limit=0", "limit=201", "state=ready"):
        assert one.get(f"/uploads?{wrong}").status_code == 422
    assert api.client.get("/uploads").status_code == 401


def test_uploads_that_are_over_are_not_listed(api: Api) -> None:
    begin(api.client, 10)
    with api.services.background.write() as session:
        (upload,) = resumable.page(session, "", before=None, limit=5, now=utc_now())
        upload.expires_at = api.services.database.now() - timedelta(seconds=1)
    assert api.client.get("/uploads").json() == {"data": [], "next_cursor": None}
