"""Uploads in pieces, against a tus server of a few lines whose faults are set here."""

from __future__ import annotations

import base64
import hashlib
import os
import stat
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from pvg_client import ApiError, Client, DamagedError, UnreachableError
from pvg_client.calls import API_PATH
from service.api import tus
from tests.client.lines import MEDIUM

PIECE = 1000
CONTENT = os.urandom(5 * PIECE + 300)


class Tus(httpx.BaseTransport):
    """tus 1.0: creation, core and checksum. ``faults`` are those of the next PATCHes, None for one without."""

    def __init__(self, *faults: str | None) -> None:
        self.faults = list(faults)
        self.refused = False
        self.uploads: dict[str, bytearray] = {}
        self.lengths: dict[str, int] = {}
        self.about: dict[str, str] = {}
        self.begun: dict[str, tuple[str, str]] = {}
        self.received_bytes = 0
        self.methods: list[str] = []

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        self.methods.append(request.method)
        path = request.url.path.removeprefix(API_PATH)
        if path.startswith("/videos/"):
            medium_id = path.removeprefix("/videos/")
            return httpx.Response(200, json=MEDIUM | {"id": medium_id, "sha256": medium_id.removeprefix("vid_")})
        if request.method != "GET":
            assert request.headers["tus-resumable"] == "1.0.0"
        if path == "/uploads":
            return self._create(request)
        if self.refused or path not in self.uploads:
            return self._refuse(request)
        data = self.uploads[path]
        if request.method == "PATCH":
            return self._patch(request, path)
        if request.method == "HEAD":
            return httpx.Response(200, headers={"Upload-Offset": str(len(data))})
        assert len(data) == self.lengths[path]
        return httpx.Response(200, json={"media": f"vid_{hashlib.sha256(data).hexdigest()}"})

    def _refuse(self, request: httpx.Request) -> httpx.Response:
        status, code = (401, "unauthenticated") if self.refused else (410, "gone")
        body = {"code": code, "title": "T", "status": status, "detail": "D", "request_id": "req_1"}
        return httpx.Response(status) if request.method == "HEAD" else httpx.Response(status, json=body)

    def _create(self, request: httpx.Request) -> httpx.Response:
        pairs = [pair.partition(" ") for pair in request.headers["upload-metadata"].split(",")]
        self.about = {name: base64.b64decode(value).decode() for name, _, value in pairs}
        key, said = request.headers["idempotency-key"], request.headers["upload-metadata"]
        if key in self.begun:
            path, before = self.begun[key]
            if said != before:
                return httpx.Response(422, json={"code": "idempotency-key-reused", "title": "T"})
            return httpx.Response(201, headers={"Location": f"{API_PATH}{path}", "Idempotent-Replayed": "true"})
        path = f"/uploads/{len(self.uploads)}"
        self.begun[key] = path, said
        self.uploads[path] = bytearray()
        self.lengths[path] = int(request.headers["upload-length"])
        return httpx.Response(201, headers={"Location": f"{API_PATH}{path}"})

    def _patch(self, request: httpx.Request, path: str) -> httpx.Response:
        fault = self.faults.pop(0) if self.faults else None
        data, body = self.uploads[path], request.read()
        assert request.headers["content-type"] == "application/offset+octet-stream"
        assert len(body) <= PIECE
        self.received_bytes += len(body)
        if fault == "busy":
            return httpx.Response(503, headers={"Retry-After": "1"})
        if int(request.headers["upload-offset"]) != len(data):
            return httpx.Response(409)
        algorithm, digest = request.headers["upload-checksum"].split(" ")
        if fault == "damaged" or algorithm != "sha256" or base64.b64decode(digest) != hashlib.sha256(body).digest():
            return httpx.Response(460)
        if fault == "cut":
            data += body[: len(body) // 2]
            raise httpx.WriteError("cut")
        data += body
        if fault == "lost answer":
            raise httpx.ReadError("lost")
        return httpx.Response(204, headers={"Upload-Offset": str(len(data))})

    def close(self) -> None:
        pass


class Meddling(Tus):
    """Something is done to the file as the third request arrives."""

    def __init__(self, meddle: Callable[[], object]) -> None:
        super().__init__()
        self._meddle = meddle

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        if len(self.methods) == 2:
            self._meddle()
        return super().handle_request(request)


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("pvg_client.tus.PIECE_BYTES", PIECE)
    monkeypatch.setattr("pvg_client.client.time.sleep", lambda seconds: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "clip, süß.mp4"
    path.write_bytes(CONTENT)
    return path


def notes(tmp_path: Path) -> list[Path]:
    return [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


def arrived(server: Tus, path: str = "/uploads/0") -> bool:
    return bytes(server.uploads[path]) == CONTENT


class ShortLived(Tus):
    """Its connections last for so many bytes."""

    def __init__(self, last: int) -> None:
        super().__init__()
        self._last = last

    def _patch(self, request: httpx.Request, path: str) -> httpx.Response:
        if len(request.read()) > self._last:
            raise httpx.WriteError("cut")
        return super()._patch(request, path)


@pytest.mark.parametrize("last", [600, 100, 10])
def test_a_file_arrives_though_no_connection_lasts_for_a_piece(file: Path, last: int) -> None:
    server = ShortLived(last)
    with Client(transport=server) as client:
        client.upload(file, resume=True)
    assert arrived(server)
    assert server.received_bytes == len(CONTENT), "what arrives is kept"


def test_a_file_arrives_in_pieces_with_what_is_said_about_it(file: Path, tmp_path: Path) -> None:
    server = Tus()
    with Client(transport=server) as client:
        medium = client.upload(file, resume=True, mask="ycbcr", metadata={"shot": "a7"})
    assert arrived(server)
    assert medium.id == f"vid_{hashlib.sha256(CONTENT).hexdigest()}"
    assert server.methods == ["POST", *["PATCH"] * 6, "GET", "GET"]
    assert {"filename": file.name, "role": "video", "mask": "ycbcr"}.items() <= server.about.items()
    assert notes(tmp_path) == []


def test_what_is_said_about_a_file_may_be_empty(file: Path) -> None:
    headers: list[str] = []

    class Noting(Tus):
        def handle_request(self, request: httpx.Request) -> httpx.Response:
            headers.extend(request.headers.get_list("upload-metadata"))
            return super().handle_request(request)

    server = Noting()
    with Client(transport=server) as client:
        client.upload(file, resume=True, metadata={"take": "", "shot": ""})
    assert {"metadata.take": "", "metadata.shot": ""}.items() <= server.about.items()
    (said,) = headers
    assert said == said.strip()  # others are sent by no client of HTTP
    assert tus.metadata(said) == server.about


@pytest.mark.parametrize("fault", ["cut", "lost answer", "damaged", "busy"])
def test_a_fault_costs_one_piece_at_most(file: Path, fault: str) -> None:
    server = Tus(None, fault, None, fault)
    with Client(transport=server, retries=1) as client:
        client.upload(file, resume=True)
    assert arrived(server)
    assert len(CONTENT) <= server.received_bytes <= len(CONTENT) + 2 * PIECE
    assert server.methods.count("POST") == 1


def test_another_run_goes_on(file: Path, tmp_path: Path) -> None:
    server = Tus(None, None, "cut")
    with Client(transport=server, retries=0) as client, pytest.raises(UnreachableError):
        client.upload(file, resume=True)
    (note,) = notes(tmp_path)
    assert stat.S_IMODE(note.stat().st_mode) == 0o600
    with Client(transport=server) as client:
        client.upload(file, resume=True)
    assert arrived(server)
    assert server.methods.count("POST") == 1
    assert server.received_bytes == len(CONTENT) + PIECE // 2
    assert notes(tmp_path) == []


def test_another_service_key_or_file_is_another_upload(file: Path) -> None:
    server = Tus(*["cut"] * 4)
    for options in ({}, {"key": "k"}, {"base_url": "http://other.test"}):
        with Client(transport=server, retries=0, **options) as client, pytest.raises(UnreachableError):  # type: ignore[arg-type]
            client.upload(file, resume=True)
    file.write_bytes(CONTENT[::-1])
    with Client(transport=server, retries=0) as client, pytest.raises(UnreachableError):
        client.upload(file, resume=True)
    assert len(server.uploads) == 4


def test_a_key_of_the_callers_own_begins_an_upload_once(file: Path, tmp_path: Path) -> None:
    server = Tus(None, "cut")
    with Client(transport=server, retries=0) as client:
        with pytest.raises(UnreachableError):
            client.upload(file, resume=True, idempotency_key="order-42")
        (note,) = notes(tmp_path)
        note.unlink()  # as on another machine
        first, second = (client.upload(file, resume=True, idempotency_key="order-42") for _ in range(2))
        assert first.id == second.id
        assert list(server.begun) == ["order-42"]
        assert server.received_bytes == len(CONTENT) + PIECE // 2
        client.upload(file, resume=True, idempotency_key="order-43")
        assert len(server.uploads) == 2
        file.write_bytes(CONTENT[::-1])
        with pytest.raises(ApiError) as caught:
            client.upload(file, resume=True, idempotency_key="order-42")
    assert caught.value.code == "idempotency-key-reused"


def test_what_is_wrong_with_an_upload_that_goes_on_is_told(file: Path) -> None:
    server = Tus(None, "cut")
    with Client(transport=server, retries=0) as client:
        with pytest.raises(UnreachableError):
            client.upload(file, resume=True)
        server.refused = True
        with pytest.raises(ApiError) as caught:
            client.upload(file, resume=True)
    error = caught.value
    assert (error.status, error.code, error.detail, error.request_id) == (401, "unauthenticated", "D", "req_1")
    assert server.methods[-2:] == ["HEAD", "GET"]


def test_uploads_under_way_with_different_keys_are_different(file: Path, tmp_path: Path) -> None:
    server = Tus(*["cut"] * 3)
    with Client(transport=server, retries=0) as client:
        for key in (None, "a", "b"):
            with pytest.raises(UnreachableError):
                client.upload(file, resume=True, idempotency_key=key)
    assert len(server.uploads) == len(notes(tmp_path)) == 3


def test_an_upload_that_has_expired_begins_anew(file: Path) -> None:
    server = Tus(None, "cut")
    with Client(transport=server, retries=0) as client:
        with pytest.raises(UnreachableError):
            client.upload(file, resume=True)
        server.uploads = {"/uploads/other": bytearray()}
        client.upload(file, resume=True)
    assert arrived(server, "/uploads/1")


def test_a_file_that_changes_while_it_is_sent_is_no_medium(file: Path, tmp_path: Path) -> None:
    server = Meddling(lambda: file.write_bytes(CONTENT[::-1]))
    with Client(transport=server) as client:
        with pytest.raises(DamagedError, match=r"clip, süß.mp4 has changed while it was sent: vid_\w+ is not"):
            client.upload(file, resume=True)
        assert notes(tmp_path) == []
        medium = client.upload(file, resume=True)
    assert medium.sha256 == hashlib.sha256(CONTENT[::-1]).hexdigest()


def test_of_a_file_that_grows_while_it_is_sent_what_was_there_arrives(file: Path) -> None:
    server = Meddling(lambda: file.write_bytes(CONTENT + CONTENT))
    with Client(transport=server) as client:
        assert client.upload(file, resume=True).sha256 == hashlib.sha256(CONTENT).hexdigest()
    assert arrived(server)


def test_faults_without_end_are_told(file: Path) -> None:
    with Client(transport=Tus(*["damaged"] * 9), retries=2) as client, pytest.raises(UnreachableError, match="460"):
        client.upload(file, resume=True)
    with Client(transport=Tus(*["busy"] * 9), retries=2) as client, pytest.raises(ApiError):
        client.upload(file, resume=True, mask="ycbcr")


@pytest.mark.parametrize("cache", ["/proc/nowhere", None])
def test_without_a_home_to_write_in_it_works_all_the_same(
    file: Path, monkeypatch: pytest.MonkeyPatch, cache: str | None
) -> None:
    if cache is None:

        def home() -> Path:
            raise RuntimeError("Could not determine home directory.")

        monkeypatch.delenv("XDG_CACHE_HOME")
        monkeypatch.setattr(Path, "home", home)
    else:
        monkeypatch.setenv("XDG_CACHE_HOME", cache)
    server = Tus("cut")
    with Client(transport=server) as client:
        client.upload(file, resume=True)
    assert arrived(server)


def test_large_files_go_in_pieces_by_themselves(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pvg_client.uploads.RESUMABLE_BYTES", len(CONTENT))
    server = Tus()
    with Client(transport=server) as client:
        client.upload(file)
    assert server.methods.count("PATCH") == 6
