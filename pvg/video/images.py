"""Still pictures in and out."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg.errors import MediaError
from pvg.video.formats import RGB24, Frame
from pvg.video.opening import MediaLimits
from pvg.video.sniffing import check_pixels, sniff

_WRITE_OPTIONS = {
    ".png": [cv2.IMWRITE_PNG_COMPRESSION, 4],
    ".jpg": [cv2.IMWRITE_JPEG_QUALITY, 95],
    ".jpeg": [cv2.IMWRITE_JPEG_QUALITY, 95],
    ".webp": [cv2.IMWRITE_WEBP_QUALITY, 95],
}
IMAGE_SUFFIXES = tuple(_WRITE_OPTIONS)
_OVERHEAD_BYTES = 64 * 2**20  # profiles, previews and text beside the samples
_STANDALONE_MARKERS = {0x01, *range(0xD0, 0xD9)}
_SIZE_MARKERS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def read_image(path: str | Path, limits: MediaLimits | None = None) -> Frame:
    """Read a JPEG, PNG or still WebP picture as one Frame of R, G, B planes (uint8).

    EXIF orientation is applied, 16-bit samples are reduced to 8, alpha is dropped (the colours under it stay as
    stored), embedded colour profiles are not. The size is checked in the header, before decoding.
    Raises MediaError.
    """
    path = Path(path)
    limits = limits or MediaLimits()
    kind = sniff(path)
    if path.stat().st_size > _OVERHEAD_BYTES + 8 * limits.max_pixels:
        raise MediaError(f"{path.name} has {path.stat().st_size} bytes, more than a picture within the limits needs")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MediaError(f"{path.name} cannot be read: {error.strerror}") from error
    width, height = image_size(path.name, kind, data)
    check_pixels(path.name, width, height, limits.max_pixels)
    try:
        bgr = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise MediaError(f"{path.name} is damaged: the {kind} picture cannot be decoded") from error
    if bgr is None:
        raise MediaError(f"{path.name} is damaged: the {kind} picture cannot be decoded")
    planes = [np.ascontiguousarray(bgr[..., k], dtype=np.uint8) for k in (2, 1, 0)]
    return Frame(0, 0, 0.0, RGB24, (planes[0], planes[1], planes[2]))


def write_image(path: str | Path, rgb: NDArray[np.uint8]) -> None:
    """Write an (H, W, 3) uint8 RGB picture as .png, .jpg or .webp (quality 95), by the name's suffix.

    Raises ValueError for another suffix or array, OSError where the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _WRITE_OPTIONS:
        raise ValueError(f"{path.name}: a picture is written as {', '.join(sorted(_WRITE_OPTIONS))}")
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        raise ValueError(f"a picture is (H, W, 3) uint8, not {rgb.shape} {rgb.dtype}")
    done, encoded = cv2.imencode(suffix, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), _WRITE_OPTIONS[suffix])
    if not done:
        raise ValueError(f"{path.name}: the picture of {rgb.shape[1]}x{rgb.shape[0]} cannot be encoded")
    path.write_bytes(encoded.tobytes())


def image_size(name: str, kind: str, data: bytes) -> tuple[int, int]:
    """(width, height) as stored, from the headers; MediaError when the file is cut short or has no size."""
    readers: dict[str, Any] = {"jpeg": _jpeg_size, "png": _png_size, "webp": _webp_size}
    if kind not in readers:
        raise MediaError(f"{name} is a clip, not a picture")
    try:
        size = readers[kind](data)
    except (struct.error, IndexError):
        size = None
    if size is None or min(size) < 1:
        raise MediaError(f"{name} is damaged or cut short: the {kind} picture is not complete; upload it again")
    return int(size[0]), int(size[1])


def _png_size(data: bytes) -> tuple[int, int] | None:
    width, height = struct.unpack(">II", data[16:24])
    at = 8
    while at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        at += 12 + length
        if kind == b"IEND":
            return width, height
    return None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at, size = 2, None
    while True:
        while data[at] == 0xFF and data[at + 1] == 0xFF:  # fill bytes
            at += 1
        marker = data[at + 1]
        if data[at] != 0xFF:
            return None
        if marker in _STANDALONE_MARKERS:
            at += 2
            continue
        (length,) = struct.unpack(">H", data[at + 2 : at + 4])
        if marker in _SIZE_MARKERS:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            size = (width, height)
        at += 2 + length
        if marker == 0xDA:  # the samples follow; a whole file ends them with the EOI marker
            return size if data.find(b"\xff\xd9", at) >= 0 else None


def _webp_size(data: bytes) -> tuple[int, int] | None:
    if 8 + int(struct.unpack("<I", data[4:8])[0]) > len(data) + 1:
        return None
    chunk = data[12:16]
    if chunk == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if chunk == b"VP8L":
        bits = struct.unpack("<I", data[21:25])[0]
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if chunk == b"VP8 ":
        width, height = struct.unpack("<HH", data[26:30])
        return width & 0x3FFF, height & 0x3FFF
    return None
