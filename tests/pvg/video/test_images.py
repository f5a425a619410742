from __future__ import annotations

import struct
import time
import zlib
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import (
    color_space,
    probe,
    read_image,
    write_image,
)
from pvg.video.metadata_record import PictureMetadata
from tests.gallery.hostile import png_chunk
from tests.gallery.profiles import P3, profile, srgb_curve


def png_of(width: int, height: int) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(b"\0" * 100)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)


def test_a_picture_bomb_is_refused_by_its_header(tmp_path: Path) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png_of(30000, 30000))
    with pytest.raises(MediaError, match="30000x30000"):
        probe(path)
    with pytest.raises(MediaError, match="30000x30000"):
        read_image(path)


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


def with_profile(path: Path, rgb: np.ndarray, icc: bytes) -> Path:
    write_image(path, rgb, metadata=PictureMetadata(icc=icc))
    return path


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".jpg", ".webp"])
@pytest.mark.parametrize("size", [(0, 0), (0, 5), (5, 0)])
def test_a_picture_of_no_pixels_is_not_written(suffix: str, size: tuple[int, int], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a picture is"):
        write_image(tmp_path / f"empty{suffix}", np.zeros((*size, 3), np.uint8))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".tif"])
def test_a_picture_with_a_profile_is_looked_at_through_it(suffix: str, tmp_path: Path) -> None:
    skin = np.full((40, 60, 3), (200, 150, 130), np.uint8)
    path = with_profile(tmp_path / f"p3{suffix}", skin, profile(P3, srgb_curve()))
    frame, info = read_image(path), probe(path)
    assert (info.color, info.warnings) == ("ICC profile", ())
    space = color_space(12, 13)
    assert space is not None
    wanted = space.to_sdr(np.array([[200.0, 150.0, 130.0]]))[0]
    np.testing.assert_allclose(frame.rgb()[20, 30], wanted, atol=3)
    assert np.abs(np.stack(frame.planes, axis=-1)[20, 30].astype(float) - (200, 150, 130)).max() <= 2
    assert probe(path, input_color="sdr").color == "SDR"


def test_a_profile_that_is_not_read_is_said(tmp_path: Path) -> None:
    skin = np.full((40, 60, 3), (200, 150, 130), np.uint8)
    path = with_profile(tmp_path / "lab.png", skin, profile(P3, srgb_curve(), pcs=b"Lab "))
    (warning,) = probe(path).warnings
    assert warning.startswith("the colour profile is one of tables")
    assert warning.endswith("the picture is read as sRGB")
    np.testing.assert_array_equal(read_image(path).rgb(), skin)


@pytest.mark.parametrize(("tags", "color"), [((9, 16), "PQ BT.2020"), ((12, 13), "sRGB P3"), ((1, 13), "SDR")])
def test_the_code_points_of_a_png_come_before_its_profile(tags: tuple[int, int], color: str, tmp_path: Path) -> None:
    chunks = ((b"cICP", bytes((*tags, 0, 1))),)
    path = tmp_path / "coded.png"
    write_image(
        path, np.full((8, 8, 3), 120, np.uint8), metadata=PictureMetadata(png=chunks, icc=profile(P3, srgb_curve()))
    )
    assert probe(path).color == color


def test_a_jpeg_full_of_fill_bytes_is_looked_through_once(tmp_path: Path) -> None:
    path = tmp_path / "filled.jpg"
    write_image(path, np.full((64, 64, 3), 120, np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[:-2] + b"\xff" * 30_000 + b"\x00" + data[-2:])
    began = time.thread_time()
    with suppress(MediaError):
        probe(path)
    assert time.thread_time() - began < 2


@pytest.mark.parametrize("grey", [False, True])
def test_a_tiff_of_jpeg_strips_is_read(tmp_path: Path, grey: bool) -> None:
    picture = np.full((64, 96) if grey else (64, 96, 3), 90, np.uint8)
    picture[:32] += 60
    path = tmp_path / "picture.tif"
    packed = [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_JPEG, cv2.IMWRITE_TIFF_ROWSPERSTRIP, 16]
    assert cv2.imwrite(str(path), picture, packed)
    read = read_image(path).rgb()
    assert np.abs(read.astype(int) - (picture[..., None] if grey else picture)).mean() < 4


def test_a_tiff_packed_in_a_way_that_is_not_read_says_how_to_save_it(tmp_path: Path) -> None:
    path = tmp_path / "picture.tif"
    write_image(path, np.full((8, 8, 3), 90, np.uint8))
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<HHIHH", 259, 3, 1, 8, 0))
    data[at + 8 : at + 10] = struct.pack("<H", 50_000)  # Zstandard
    path.write_bytes(data)
    with pytest.raises(MediaError, match="packed in a way that is not read"):
        read_image(path)
