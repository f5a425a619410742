"""What is accepted and what is refused, on files made here and on the labelled media's odd and hostile ones."""

from __future__ import annotations

import socket
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import MediaLimits, VideoWriter, probe, read_frames, read_image, write_image
from scripts.samples import Samples


def every_frame(path: Path, limits: MediaLimits | None = None) -> int:
    return sum(1 for _ in read_frames(path, limits=limits))


def png_of(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


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


def test_a_picture_bomb_is_refused_by_its_header(tmp_path: Path) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png_of(30000, 30000))
    with pytest.raises(MediaError, match="30000x30000"):
        probe(path)
    with pytest.raises(MediaError, match="30000x30000"):
        read_image(path)


def test_every_limit_is_kept_and_named(samples: Samples) -> None:
    clip = samples.woman_clip  # 640x360, 168 frames, 24 a second, 7 s
    for limits, words in (
        (MediaLimits(max_pixels=640 * 360 - 1), "640x360"),
        (MediaLimits(max_frames=100), "frames"),
        (MediaLimits(max_duration_s=3.0), r"3\.0 s"),
        (MediaLimits(max_streams=0), "stream"),
    ):
        with pytest.raises(MediaError, match=words):
            probe(clip, limits)
        with pytest.raises(MediaError, match=words):
            every_frame(clip, limits)
    with pytest.raises(MediaError, match="frames a second"):
        probe(clip, MediaLimits(max_frame_rate=10.0))
    assert every_frame(clip, MediaLimits(max_pixels=640 * 360, max_frames=168, max_duration_s=7.1)) == 168


def test_a_cut_off_clip_is_refused(samples: Samples, tmp_path: Path) -> None:
    body = samples.single_face_clip.read_bytes()
    for part in (0.3, 0.6, 0.9):
        path = tmp_path / "cut.mp4"
        path.write_bytes(body[: int(part * len(body))])
        with pytest.raises(MediaError):
            every_frame(path)


def test_a_jpeg_is_turned_as_its_exif_says(tmp_path: Path) -> None:
    rgb = np.zeros((40, 60, 3), np.uint8)
    rgb[:20, :30] = (255, 0, 0)
    ok, data = cv2.imencode(".jpg", rgb[..., ::-1])
    assert ok
    # an APP1 segment with one tag: orientation 6, the stored picture is to be turned clockwise
    tiff = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    segment = b"Exif\0\0" + tiff
    body = bytes(data)
    turned = body[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + body[2:]
    path = tmp_path / "turned.jpg"
    path.write_bytes(turned)
    info, frame = probe(path), read_image(path)
    assert (info.width, info.height) == (40, 60)
    assert frame.rgb().shape == (60, 40, 3)
    assert frame.rgb()[5, 30, 0] > 200  # the red corner has moved from the upper left to the upper right
    assert frame.rgb()[5, 5, 0] < 60


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp"])
def test_pictures_are_written_and_read_back(suffix: str, tmp_path: Path) -> None:
    y, x = np.mgrid[:48, :64]
    rgb = np.stack([x * 4, y * 5, 128 + x], axis=-1).astype(np.uint8)
    write_image(tmp_path / f"out{suffix}", rgb)
    back = read_image(tmp_path / f"out{suffix}").rgb().astype(int)
    assert np.abs(back - rgb).max() <= (0 if suffix == ".png" else 24)
    assert np.abs(back - rgb).mean() <= (0 if suffix == ".png" else 3.0)


# --- the labelled media ---------------------------------------------------------------------------------------


def test_hostile_files_are_refused(media_dir: Path) -> None:
    bad = sorted(path for path in (media_dir / "odd").iterdir() if path.name.startswith("bad_"))
    assert len(bad) >= 15
    for path in bad:
        if path.name == "bad_jpeg_named.mp4":  # a portrait with a wrong name: its bytes are fine
            assert probe(path).kind == "image"
            continue
        if path.name == "bad_declares_16384x16384_header_only.mp4":
            with pytest.raises(MediaError):
                probe(path)
            continue
        with pytest.raises(MediaError) as caught:
            every_frame(path)
        assert "\n" not in str(caught.value), path.name


def test_external_references_are_never_opened(media_dir: Path, tmp_path: Path) -> None:
    """A clip whose data lives at a URL is refused without a connection to it."""
    address = b"http://127.0.0.1:9/"
    body = (media_dir / "odd" / "bad_external_dref_http.mp4").read_bytes()
    assert address in body
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        # a port of five digits in the place of "9/": the box keeps its length when the path loses as much
        ours = f"http://127.0.0.1:{server.getsockname()[1]}/".encode()
        start = body.index(address)
        end = body.index(b"\0", start)
        path = tmp_path / "remote.mp4"
        path.write_bytes(body[:start] + ours.ljust(end - start, b"x")[: max(end - start, len(ours))] + body[end:])
        with pytest.raises(MediaError):
            every_frame(path)
        with pytest.raises(BlockingIOError):
            server.accept()


def test_odd_clips_are_read(media_dir: Path) -> None:
    odd = media_dir / "odd"
    read = {}
    for path in sorted(odd.iterdir()):
        if path.name.startswith("bad_") or path.suffix in (".md", ".gif"):
            continue
        read[path.name] = every_frame(path)
        assert read[path.name] == probe(path).frame_count or path.name == "interlaced_tff.mp4", path.name
    assert len(read) >= 18
    assert read["single_frame.mp4"] == 1
    assert read["portrait_exif_orientation6.jpg"] == 1
    assert (
        min(count for name, count in read.items() if name not in ("single_frame.mp4", "portrait_exif_orientation6.jpg"))
        > 20
    )


def test_an_animated_gif_is_refused_by_name(media_dir: Path) -> None:
    with pytest.raises(MediaError, match=r"(?i)gif"):
        probe(media_dir / "odd" / "animation.gif")


def test_matrix_and_range_tags_give_the_same_picture(media_dir: Path) -> None:
    """The same pixels coded four ways decode to about the same RGB, and any other reading of them is worse.

    Coding alone costs these files 0.9 to 2.3 levels; a wrong matrix or range costs 3.8 to 7.2.
    """
    names = ("bt601_full_range", "bt601_limited_range", "bt709_full_range", "bt709_limited_range")
    frames = [next(read_frames(media_dir / "odd" / f"{name}.mp4")) for name in names]
    first = frames[0].rgb().astype(float)
    for frame in frames:
        readings = [np.clip(other.format.to_rgb(frame.planes), 0, 255) for other in frames]
        errors = {other.format: np.abs(rgb - first).mean() for other, rgb in zip(frames, readings, strict=True)}
        assert errors.pop(frame.format) < 2.5
        assert min(errors.values()) > 3.5
        assert np.abs(frame.rgb() - first).mean() < 2.5


def test_a_sideways_clip_is_upright(media_dir: Path) -> None:
    info = probe(media_dir / "odd" / "rotated90_display_matrix.mp4")
    assert info.rotation in (90, 270)
    frame = next(read_frames(media_dir / "odd" / "rotated90_display_matrix.mp4"))
    assert (frame.width, frame.height) == (info.width, info.height)
    sky = cv2.resize(frame.rgb(), (8, 8), interpolation=cv2.INTER_AREA)
    assert sky.shape == (8, 8, 3)


def test_variable_frame_rates_pass_through_exactly(media_dir: Path, tmp_path: Path) -> None:
    source = media_dir / "odd" / "vfr_jittered.mp4"
    info = probe(source)
    stamps = [frame.pts for frame in read_frames(source)]
    assert len(set(np.diff(stamps).tolist())) > 3
    with VideoWriter(tmp_path / "out.mp4", info, info.format, audio_from=source) as writer:
        for frame in read_frames(source):
            writer.write(frame)
    seen = probe(tmp_path / "out.mp4")
    assert seen.time_base is not None
    assert info.time_base is not None
    written = [frame.pts * seen.time_base for frame in read_frames(tmp_path / "out.mp4")]
    assert written == [pts * info.time_base for pts in stamps]


def test_ten_bits_stay_ten_bits(media_dir: Path, tmp_path: Path) -> None:
    for name in ("hevc_10bit.mp4", "prores_proxy.mov"):
        source = media_dir / "odd" / name
        info = probe(source)
        assert info.format.depth == 10
        with VideoWriter(tmp_path / "out.mp4", info, info.format) as writer:
            for frame in read_frames(source, stop=5):
                writer.write(frame)
        seen = next(read_frames(tmp_path / "out.mp4"))
        assert seen.format == info.format
        first = next(read_frames(source))
        assert np.abs(seen.planes[0].astype(int) - first.planes[0]).mean() < 8  # of 1023
