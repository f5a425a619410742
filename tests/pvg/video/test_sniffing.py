from __future__ import annotations

from pathlib import Path

import pytest

from pvg.errors import MediaError
from pvg.video import (
    probe,
)
from scripts.samples import Samples
from tests.gallery.clips import (
    every_frame,
)


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("empty.mp4", b""),
        ("text.mp4", b"this is text and no clip at all"),
        ("list.m3u8", b"#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n"),
        ("list.mp4", b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/\n"),
        ("concat.mp4", b"ffconcat version 1.0\nfile /etc/passwd\n"),
        ("drawing.jpg", b'<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/passwd"/></svg>'),
        ("anim.gif", b"GIF89a" + b"\0" * 64),
        ("cut.jpg", b"\xff\xd8\xff\xe0\x00\x10JFIF" + b"\0" * 8),
        ("cut.webm", b"\x1a\x45\xdf\xa3" + b"\0" * 40),
        ("cut.mp4", b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom"),
        ("sheet.pdf", b"%PDF-1.7\n"),
    ],
)
def test_what_is_no_clip_or_picture_is_refused_in_one_line(name: str, body: bytes, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(body)
    for read in (probe, every_frame):
        with pytest.raises(MediaError) as caught:
            read(path)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_picture_is_known_by_its_bytes_not_its_name(samples: Samples, tmp_path: Path) -> None:
    path = tmp_path / "portrait.mp4"
    path.write_bytes(samples.portrait.read_bytes())
    assert probe(path).kind == "image"
    assert every_frame(path) == 1


# the labelled media


def test_hostile_files_are_refused(media_dir: Path) -> None:
    bad = sorted(path for path in (media_dir / "odd").iterdir() if path.name.startswith("bad_"))
    assert len(bad) >= 15
    for path in bad:
        if path.name == "bad_jpeg_named.mp4":  # a portrait with a wrong name: its bytes are fine
            assert probe(path).kind == "image"
            continue
        if path.name == "bad_truncated_45pct.mp4":  # its beginning is read, see test_odd_media
            continue
        if path.name == "bad_declares_16384x16384_header_only.mp4":
            with pytest.raises(MediaError):
                probe(path)
            continue
        with pytest.raises(MediaError) as caught:
            every_frame(path)
        assert "\n" not in str(caught.value), path.name


def test_an_animated_gif_is_refused_by_name(media_dir: Path) -> None:
    with pytest.raises(MediaError, match=r"(?i)gif"):
        probe(media_dir / "odd" / "animation.gif")
