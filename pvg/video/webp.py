"""WebP files (RFC 9649): size, metadata found and put in (VP8X, ICCP, EXIF)."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from pvg.video.metadata_record import PictureMetadata, counted, with_exif

_WEBP_ICC, _WEBP_ALPHA, _WEBP_EXIF = 0x20, 0x10, 0x08


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at, count = 12, 0
    while at + 8 <= len(data):
        count = counted(count, "chunks")
        kind, length = struct.unpack_from("<4sI", data, at)
        yield kind, data[at + 8 : at + 8 + length]
        at += 8 + length + length % 2


def webp_metadata(data: bytes) -> PictureMetadata:
    """See `picture_metadata.metadata_of`. Raises `struct.error`, `IndexError` and `TooManyPartsError`."""
    chunks = dict(reversed(list(_chunks(data))))
    has_alpha = b"ALPH" in chunks
    if b"VP8L" in chunks:  # bit 28 after the signature and the two sizes: alpha_is_used
        has_alpha = bool(struct.unpack_from("<I", chunks[b"VP8L"], 1)[0] >> 28 & 1)
    known = {b"VP8X", b"VP8 ", b"VP8L", b"ALPH", b"ICCP", b"EXIF"}
    lost = ["XMP" if kind == b"XMP " else "a further chunk" for kind in chunks if kind not in known]
    return with_exif(
        PictureMetadata(icc=chunks.get(b"ICCP"), has_alpha=has_alpha, lost=tuple(dict.fromkeys(lost))),
        chunks.get(b"EXIF"),
    )


def into_webp(data: bytes, metadata: PictureMetadata, size: tuple[int, int]) -> bytes:
    """An encoded WebP file with profile and EXIF put in;  size: its (width, height)."""
    chunks = list(_chunks(data))
    flags = dict(chunks).get(b"VP8X", b"\0")[0]
    if b"VP8L" in dict(chunks) and struct.unpack_from("<I", dict(chunks)[b"VP8L"], 1)[0] >> 28 & 1:
        flags |= _WEBP_ALPHA
    picture = [(kind, body) for kind, body in chunks if kind in (b"ALPH", b"VP8 ", b"VP8L")]
    if metadata.icc is not None:
        picture.insert(0, (b"ICCP", metadata.icc))
        flags |= _WEBP_ICC
    if metadata.exif is not None:
        picture.append((b"EXIF", metadata.exif))
        flags |= _WEBP_EXIF
    canvas = b"".join((side - 1).to_bytes(3, "little") for side in size)
    picture.insert(0, (b"VP8X", bytes([flags, 0, 0, 0]) + canvas))
    body = b"".join(kind + struct.pack("<I", len(item)) + item + b"\0" * (len(item) % 2) for kind, item in picture)
    return b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body


def webp_size(data: bytes) -> tuple[int, int] | None:
    """(width, height); None when the file is cut short. Raises `struct.error` and `IndexError`."""
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
