"""JPEG files (ITU-T T.81): size, metadata found and put in, by ICC.1 annex B.4 (APP2) and CIPA DC-008 (APP1)."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from pvg.video.metadata_record import MOST_PARTS, PictureMetadata, TooManyPartsError, counted, with_exif

MOST_EXIF_BYTES = 65535 - 2 - 6
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of the segments that say the size and the components."""
_INKS = 4
_ICC_SEGMENT = b"ICC_PROFILE\0"
_EXIF_SEGMENT = b"Exif\0\0"
_JFIF_SEGMENT = b"JFIF\0"
_DENSITY, _NO_DENSITY = slice(7, 12), b"\0\0\1\0\1"
_XMP_SEGMENTS = (b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0")
_STANDALONE = {0x01, *range(0xD0, 0xD9)}
_MOST_SCANS = 100  # encoders make 10 of a progressive picture; each is gone through in full size
_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")  # in a scan's data: neither a stuffed byte nor a restart


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(marker, body) of the segments before the samples."""
    at, count = 2, 0
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        count = counted(count, "segments")
        if marker in _STANDALONE:
            at += 2
            continue
        if marker in (0xDA, 0xD9):
            return
        (length,) = struct.unpack_from(">H", data, at + 2)
        yield marker, data[at + 4 : at + 2 + length]
        at += 2 + length


def jpeg_metadata(data: bytes) -> PictureMetadata:
    """See `picture_metadata.metadata_of`. Raises `struct.error`, `IndexError` and `TooManyPartsError`."""
    parts: dict[int, bytes] = {}
    exif, density, lost = None, None, []
    for marker, body in _segments(data):
        if marker == 0xE0 and body.startswith(_JFIF_SEGMENT) and body[_DENSITY] != _NO_DENSITY:
            density = body[_DENSITY]
        elif marker == 0xE2 and body.startswith(_ICC_SEGMENT):
            parts[body[len(_ICC_SEGMENT)]] = body[len(_ICC_SEGMENT) + 2 :]
        elif marker == 0xE1 and body.startswith(_EXIF_SEGMENT):
            exif = body if exif is None else exif
        elif marker == 0xE1 and body.startswith(_XMP_SEGMENTS):
            lost.append("XMP")
        elif marker == 0xE2 and body.startswith(b"MPF\0"):
            lost.append("further pictures (such as a gain map)")
        elif marker == 0xED:
            lost.append("IPTC")
        elif marker == 0xFE:
            lost.append("text")
        elif marker in _FRAMES and len(body) > 5 and body[5] == _INKS:
            lost.append("coding in four inks (CMYK)")
        elif 0xE0 < marker <= 0xEF and marker != 0xEE:
            lost.append(f"the segment APP{marker - 0xE0}")
    icc = b"".join(parts[k] for k in sorted(parts)) if parts else None
    return with_exif(PictureMetadata(icc=icc, density=density, lost=tuple(dict.fromkeys(lost))), exif)


def into_jpeg(data: bytes, metadata: PictureMetadata) -> bytes:
    """An encoded JPEG file with profile, EXIF and density put in."""
    segments = b""
    if metadata.exif is not None and len(metadata.exif) <= MOST_EXIF_BYTES:
        segments += _segment(0xE1, _EXIF_SEGMENT + metadata.exif)
    if metadata.icc is not None:
        room = 65535 - 2 - len(_ICC_SEGMENT) - 2
        pieces = [metadata.icc[k : k + room] for k in range(0, len(metadata.icc), room)]
        if len(pieces) <= 255:
            for number, piece in enumerate(pieces, 1):
                segments += _segment(0xE2, _ICC_SEGMENT + bytes([number, len(pieces)]) + piece)
    if data[2:4] != b"\xff\xe0":
        return data[:2] + segments + data[2:]
    # JFIF asks to be the first segment
    at = 4 + struct.unpack_from(">H", data, 4)[0]
    first = bytearray(data[6:at])
    first[_DENSITY] = metadata.density or first[_DENSITY]
    return data[:6] + bytes(first) + segments + data[at:]


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """(width, height); None when the file is cut short. Raises `struct.error`, `IndexError`, `TooManyPartsError`."""
    at, size = 2, None
    for _ in range(MOST_PARTS):
        while data[at] == 0xFF and data[at + 1] == 0xFF:  # fill bytes
            at += 1
        marker = data[at + 1]
        if data[at] != 0xFF:
            return None
        if marker in _STANDALONE:
            at += 2
            continue
        (length,) = struct.unpack(">H", data[at + 2 : at + 4])
        if marker in _FRAMES:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            size = (width, height)
        at += 2 + length
        if marker == 0xDA:  # the samples follow; a whole file ends them with the EOI marker
            _check_scans(data, at)
            return size if data.find(b"\xff\xd9", at) >= 0 else None
    raise TooManyPartsError(f"{MOST_PARTS} segments")


def _check_scans(data: bytes, at: int) -> None:
    """Count the scans that a decoder would go through; at: where the data of the first one begin."""
    scans = 1
    while (found := _MARKER.search(data, at)) and data[found.end() - 1] != 0xD9:
        at = found.end()
        scans += data[at - 1] == 0xDA
        if scans > _MOST_SCANS:
            raise TooManyPartsError(f"{_MOST_SCANS} scans")
        at += int.from_bytes(data[at : at + 2], "big")
