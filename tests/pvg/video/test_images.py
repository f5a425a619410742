from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import (
    probe,
    read_image,
    write_image,
)


def png_of(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


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
