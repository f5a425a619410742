"""Files on their way to a path: names at the limit of a file system, and two downloads at a time."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import quote

import httpx
import pytest

from pvg_client import ApiError, AsyncClient, Client
from pvg_client.files import PartFile
from pvg_client.models import Result

CONTENT = os.urandom(200_000)
RESULT = Result("res_1", "/v1/results/res_1", len(CONTENT), "video/mp4", hashlib.sha256(CONTENT).hexdigest())


class Store(httpx.BaseTransport):
    """Has one file, of which the second half comes once ``wanted`` downloads have the first; and knows ranges."""

    def __init__(self, wanted: int = 1) -> None:
        self._half = threading.Barrier(wanted)
        self.gone = False

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        if self.gone:
            return httpx.Response(410, json={"code": "gone", "title": "Gone"})
        begin = int(request.headers.get("range", "bytes=0-")[6:-1])
        headers = {"Content-Range": f"bytes {begin}-{len(CONTENT) - 1}/{len(CONTENT)}"} if begin else {}
        return httpx.Response(206 if begin else 200, headers=headers, stream=_Halves(self._half, CONTENT[begin:]))


class _Halves(httpx.SyncByteStream):
    def __init__(self, half: threading.Barrier, content: bytes) -> None:
        self._half, self._content = half, content

    def __iter__(self) -> Iterator[bytes]:
        middle = len(self._content) // 2
        yield self._content[:middle]
        self._half.wait(120)
        yield self._content[middle:]


@pytest.mark.parametrize(
    "name", ["ж" * 125 + ".mp4", "微" * 83 + ".mp4", "a" * 251 + ".mp4"], ids=("Cyrillic", "Chinese", "ASCII")
)
def test_a_name_may_be_as_long_as_the_file_system_takes(tmp_path: Path, name: str) -> None:
    assert len(name.encode()) in range(252, 256)
    with Client(transport=Store()) as client:
        path = client.download(RESULT, tmp_path / name)
    assert path.read_bytes() == CONTENT
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("said", "name"),
    [
        ("inline; filename*=UTF-8''frau%20l%C3%A4chelt-a.mp4", "frau lächelt-a.mp4"),
        ("inline; filename=\"frau l_chelt-a.mp4\"; filename*=UTF-8''frau%20l%C3%A4chelt-a.mp4", "frau lächelt-a.mp4"),
        ("inline; filename*=UTF-8''..%2F..%2Fetc%2Fpasswd", "passwd"),
        ("inline; filename*=UTF-8''..%2F..", "res_1"),
        ("inline; filename*=UTF-8''C:%5Ctakes%5CD:12.mp4", "D_12.mp4"),
        (f"inline; filename*=UTF-8''{'%E5%BE%AE' * 100}.mp4", "微" * 80 + ".mp4"),
        (f"inline; filename*=UTF-8''{'%D0%B6' * 125}.mp4", "ж" * 125 + ".mp4"),
        (f"inline; filename*=UTF-8''a.{'%D0%B6' * 200}", "a." + "ж" * 119),
        ("inline", "res_1"),
    ],
)
def test_in_a_folder_a_file_has_its_own_name_and_stays_there(tmp_path: Path, said: str, name: str) -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        headers = {"ETag": f'"{RESULT.sha256}"', "Content-Disposition": said}
        content = b"" if request.method == "HEAD" else CONTENT
        return httpx.Response(200, headers=headers, stream=httpx.ByteStream(content))

    with Client(transport=httpx.MockTransport(answer)) as client:
        assert client.download(RESULT, tmp_path) == tmp_path / name
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == CONTENT


def test_a_folder_that_is_not_there_is_no_file(tmp_path: Path) -> None:
    with Client(
        transport=httpx.MockTransport(lambda _: httpx.Response(200, stream=httpx.ByteStream(CONTENT)))
    ) as client:
        with pytest.raises(FileNotFoundError, match="folder"):
            client.download(RESULT, f"{tmp_path}/looks/")
        assert contents(tmp_path) == {}
        assert client.download(RESULT, f"{tmp_path}/looks").read_bytes() == CONTENT


class Named(httpx.BaseTransport):
    """Has files of one name, each under the path of its result."""

    def __init__(self, name: str, *contents: bytes) -> None:
        self._said = f"inline; filename*=UTF-8''{quote(name)}"
        self._contents = {f"/v1/results/res_{number}": content for number, content in enumerate(contents, start=1)}
        self.bodies = 0

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        content = self._contents[request.url.path]
        headers = {"ETag": f'"{hashlib.sha256(content).hexdigest()}"', "Content-Disposition": self._said}
        if request.method == "HEAD":
            return httpx.Response(200, headers=headers)
        self.bodies += 1
        begin = int(request.headers.get("range", "bytes=0-")[6:-1])
        headers |= {"Content-Range": f"bytes {begin}-{len(content) - 1}/{len(content)}"} if begin else {}
        return httpx.Response(206 if begin else 200, headers=headers, stream=httpx.ByteStream(content[begin:]))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_in_a_folder_no_other_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "look (2).mp4").mkdir()
    store = Named("look.mp4", b"one", b"two", b"three")
    with Client(transport=store) as client:
        paths = [client.download(f"res_{number}", tmp_path) for number in (1, 2, 3)]
        assert [path.name for path in paths] == ["look.mp4", "look (3).mp4", "look (4).mp4"]
        (tmp_path / "look (2).mp4").rmdir()
        assert contents(tmp_path) == {"look.mp4": b"one", "look (3).mp4": b"two", "look (4).mp4": b"three"}


def test_in_a_folder_what_is_there_already_is_found_again(tmp_path: Path) -> None:
    store = Named("look.mp4", b"one", b"two")
    with Client(transport=store) as client:
        paths = [client.download(f"res_{number}", tmp_path) for number in (1, 2)]
        assert [client.download(f"res_{number}", tmp_path) for number in (1, 2)] == paths
        assert store.bodies == 2
        paths[1].write_bytes(b"edited")
        assert client.download("res_2", tmp_path).name == "look (3).mp4"
    assert contents(tmp_path) == {"look.mp4": b"one", "look (2).mp4": b"edited", "look (3).mp4": b"two"}


def test_in_a_folder_a_download_goes_on_whatever_came_under_its_name(tmp_path: Path) -> None:
    sha256 = hashlib.sha256(CONTENT).hexdigest()
    (tmp_path / f".look.mp4.{sha256[:16]}.part").write_bytes(CONTENT[:150_000])
    (tmp_path / "look.mp4").write_bytes(b"another")
    with Client(transport=Named("look.mp4", CONTENT)) as client:
        path = client.download("res_1", tmp_path)
    assert contents(tmp_path) == {"look.mp4": b"another", "look (2).mp4": CONTENT}
    assert path == tmp_path / "look (2).mp4"


@pytest.mark.parametrize("links", [True, False], ids=("links", "no links"))
def test_results_of_one_name_that_come_at_once_all_stay(
    tmp_path: Path, links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "this file system has no links")

    if not links:
        monkeypatch.setattr(os, "link", refuse)
    names = ["res_1", "res_2", "res_3", "res_1"]

    async def all_at_once() -> list[Path]:
        made = Named("look.mp4", b"one", b"two", b"three")

        async with AsyncClient(transport=httpx.MockTransport(made.handle_request)) as client:
            return list(await asyncio.gather(*(client.download(name, tmp_path) for name in names)))

    paths = asyncio.run(all_at_once())
    assert [path.read_bytes() for path in paths] == [b"one", b"two", b"three", b"one"]
    if links:
        assert sorted(contents(tmp_path)) == ["look (2).mp4", "look (3).mp4", "look.mp4"]


def test_a_long_name_has_room_for_its_number(tmp_path: Path) -> None:
    store = Named("微" * 100 + ".mp4", b"one", b"two")
    with Client(transport=store) as client:
        paths = [client.download(f"res_{number}", tmp_path) for number in (1, 2)]
    assert [path.name for path in paths] == ["微" * 80 + ".mp4", "微" * 80 + " (2).mp4"]
    assert len(paths[1].name.encode()) <= 255


def test_two_downloads_to_one_path_do_not_mix(tmp_path: Path) -> None:
    target = tmp_path / "look.mp4"
    with Client(transport=Store(3)) as client, ThreadPoolExecutor() as threads:
        paths = list(threads.map(lambda _: client.download(RESULT, target), range(3)))
    assert paths == [target] * 3
    assert target.read_bytes() == CONTENT
    assert list(tmp_path.iterdir()) == [target]


def test_a_download_of_nothing_leaves_nothing(tmp_path: Path) -> None:
    store = Store()
    store.gone = True
    with Client(transport=store) as client, pytest.raises(ApiError):
        client.download(RESULT, tmp_path / "look.mp4")
    assert list(tmp_path.iterdir()) == []


def test_what_is_wrong_with_a_file_that_is_asked_for_by_head_is_told(tmp_path: Path) -> None:
    requests: list[httpx.Request] = []

    def answer(request: httpx.Request) -> httpx.Response:
        requests.append(request)
        body = {"code": "gone", "title": "Gone", "detail": "D", "request_id": "req_2"}
        return httpx.Response(410) if request.method == "HEAD" else httpx.Response(410, json=body)

    with Client(transport=httpx.MockTransport(answer)) as client, pytest.raises(ApiError) as caught:
        client.download("res_1", tmp_path / "look.mp4")
    error = caught.value
    assert (error.status, error.code, error.detail, error.request_id) == (410, "gone", "D", "req_2")
    assert [(request.method, request.headers.get("range")) for request in requests] == [
        ("HEAD", None),
        ("GET", "bytes=0-0"),
    ]


@pytest.mark.parametrize(
    "then", [httpx.Response(206, content=b"a"), httpx.Response(503), httpx.ConnectError("refused")]
)
def test_where_nothing_more_is_told_the_first_error_stays(tmp_path: Path, then: httpx.Response | Exception) -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        if request.method == "HEAD":
            return httpx.Response(403)
        if isinstance(then, Exception):
            raise then
        return then

    with Client(transport=httpx.MockTransport(answer)) as client, pytest.raises(ApiError) as caught:
        client.download("res_1", tmp_path / "look.mp4")
    assert (caught.value.status, caught.value.title) == (403, "Forbidden")


def test_a_part_whose_name_was_removed_has_its_size_still(tmp_path: Path) -> None:
    part = PartFile(tmp_path / "look.mp4", RESULT.sha256)
    part.write(CONTENT)
    part.path.unlink()
    assert part.size == len(CONTENT)
    part.close()
    assert list(tmp_path.iterdir()) == []


def test_a_part_that_is_put_in_its_place_while_it_is_looked_at_is_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "look.mp4"
    real, puts = os.fstat, [lambda: next(tmp_path.iterdir()).replace(target)]

    def fstat(descriptor: int) -> os.stat_result:
        if puts:
            puts.pop()()
        return real(descriptor)

    monkeypatch.setattr(os, "fstat", fstat)
    part = PartFile(target, RESULT.sha256)
    assert puts == []
    part.write(CONTENT)
    part.put(target)
    assert target.read_bytes() == CONTENT
    assert list(tmp_path.iterdir()) == [target]
