"""Uploads in pieces to the real service, over a line that breaks."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from pvg_client import ApiError, Client, DamagedError, UnreachableError
from scripts.samples import Samples
from tests.client.lines import Line

PIECE = 50_000


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("pvg_client.tus.PIECE_BYTES", PIECE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_a_file_arrives_whole_over_a_line_that_breaks(url: str, samples: Samples) -> None:
    line = Line(cuts=3, cut_bytes=PIECE // 2)
    with Client(url, transport=line) as client:
        medium = client.upload(samples.portrait, role="reference", resume=True, mask="ycbcr", metadata={"shot": "a7"})
        content = samples.portrait.read_bytes()
        assert (medium.role, medium.filename, medium.size_bytes) == ("reference", samples.portrait.name, len(content))
        assert medium.sha256 == hashlib.sha256(content).hexdigest()
        assert (medium.settings["mask"], medium.metadata) == ("ycbcr", {"shot": "a7"})
        assert client.upload(samples.portrait, role="reference", mask="ycbcr", resume=False).id == medium.id
    assert line.methods().count("HEAD") == 3


def test_another_run_sends_the_rest(url: str, samples: Samples) -> None:
    size = samples.pale_portrait.stat().st_size
    broken = Line(cuts=1, cut_bytes=PIECE // 2, spared=3)  # the creation and two pieces
    with Client(url, transport=broken, retries=0) as client, pytest.raises(UnreachableError):
        client.upload(samples.pale_portrait, role="reference", resume=True)
    assert broken.methods() == ["POST", "PATCH", "PATCH", "PATCH"]
    line = Line()
    with Client(url, transport=line) as client:
        client.upload(samples.pale_portrait, role="reference", resume=True)
    assert line.methods()[0] == "HEAD"
    assert "POST" not in line.methods()
    assert line.sent_bytes == size - 2 * PIECE


def test_what_is_no_medium_is_told_and_forgotten(url: str, tmp_path: Path) -> None:
    text = tmp_path / "text.mp4"
    text.write_bytes(b"no clip" * PIECE)
    with Client(url) as client:
        for _ in range(2):
            with pytest.raises(ApiError) as caught:
                client.upload(text, resume=True)
            assert caught.value.status == 415
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


def test_a_key_of_the_callers_own_is_for_one_file(url: str, samples: Samples, tmp_path: Path) -> None:
    path = tmp_path / "portrait.jpg"
    path.write_bytes(samples.dark_portrait.read_bytes())
    with Client(url) as client:
        first, second = (
            client.upload(path, role="reference", resume=True, idempotency_key="order-42") for _ in range(2)
        )
        assert first.id == second.id
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.write_bytes(content)
        with pytest.raises(ApiError) as caught:
            client.upload(path, role="reference", resume=True, idempotency_key="order-42")
    assert caught.value.code == "idempotency-key-reused"


def test_who_has_lost_its_notes_finds_its_upload_and_goes_on(
    url: str, samples: Samples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "clip.jpg"
    path.write_bytes(samples.portrait.read_bytes() + b"lost")
    broken = Line(cuts=1, cut_bytes=PIECE // 2, spared=2)  # the creation and a piece
    with Client(url, transport=broken, retries=0) as client, pytest.raises(UnreachableError):
        client.upload(path, role="reference", resume=True, metadata={"order": "lost"})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "another"))
    line = Line()
    with Client(url, transport=line) as client:
        (begun,) = (one for one in client.uploads() if one.metadata == {"order": "lost"})
        assert (begun.role, begun.filename, begun.size_bytes) == ("reference", path.name, path.stat().st_size)
        assert begun.offset_bytes >= PIECE
        with pytest.raises(ValueError, match="bytes"):
            client.upload(samples.portrait, resume=begun)
        with pytest.raises(ValueError, match="the file alone"):
            client.upload(path, resume=begun, metadata={"order": "43"})
        medium = client.upload(path, resume=begun)
        assert (medium.role, medium.metadata) == ("reference", {"order": "lost"})
        assert medium.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        assert line.sent_bytes == path.stat().st_size - begun.offset_bytes
        assert begun.id not in [one.id for one in client.uploads()]
        assert client.upload_state(begun).media == medium.id
        left = client.upload_link()
        assert left.id in [one.id for one in client.uploads()]
        client.delete(left.id)
        assert left.id not in [one.id for one in client.uploads()]
    assert not [one for one in (tmp_path / "another").rglob("*") if one.is_file()]


def test_an_upload_that_goes_on_with_another_file_of_its_size_is_told(
    url: str, samples: Samples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "clip.jpg"
    content = bytearray(samples.portrait.read_bytes() + b"other")
    path.write_bytes(content)
    broken = Line(cuts=1, cut_bytes=PIECE // 2, spared=2)
    with Client(url, transport=broken, retries=0) as client, pytest.raises(UnreachableError):
        client.upload(path, role="reference", resume=True, metadata={"order": "other"})
    content[10] ^= 1  # in what has arrived
    path.write_bytes(content)
    with Client(url) as client:
        (begun,) = (one for one in client.uploads() if one.metadata == {"order": "other"})
        with pytest.raises(DamagedError, match="is not that file"):
            client.upload(path, resume=begun)
