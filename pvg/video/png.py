"""PNG files (W3C Portable Network Graphics, third edition): size, metadata found and put in (iCCP, eXIf)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from pvg.video.metadata_record import MOST_ICC_BYTES, PictureMetadata, counted, with_exif

_PNG_SIGNATURE = 8
_PNG_COLOR = {b"cICP", b"mDCV", b"cLLI", b"gAMA", b"cHRM", b"sRGB", b"pHYs"}
_PNG_TEXT = {b"tEXt", b"zTXt", b"iTXt"}
_PNG_NEEDED = {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"iCCP", b"eXIf", b"bKGD", b"hIST", b"sBIT", b"tIME"}


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at, count = _PNG_SIGNATURE, 0
    while at + 12 <= len(data):
        count = counted(count, "chunks")
        length, kind = struct.unpack_from(">I4s", data, at)
        yield kind, data[at + 8 : at + 8 + length] if kind != b"IDAT" else b""
        at += 12 + length


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_metadata(data: bytes) -> PictureMetadata:
    """See `picture_metadata.metadata_of`. Raises `struct.error`, `IndexError` and `TooManyPartsError`."""
    depth, color = data[24], data[25]
    icc, exif, has_alpha, lost = None, None, bool(color & 4), []
    shown: dict[bytes, bytes] = {}
    for kind, body in _chunks(data):
        has_alpha |= kind == b"tRNS"
        if kind == b"iCCP" and icc is None:
            icc = _inflated(body.partition(b"\0")[2][1:])
        elif kind == b"eXIf":
            exif = body
        elif kind in _PNG_COLOR and len(body) <= 64:
            shown.setdefault(kind, body)
        elif kind in _PNG_TEXT:
            lost.append("XMP" if body.startswith(b"XML:com.adobe.xmp") else "text")
        elif kind in (b"acTL", b"fcTL", b"fdAT"):
            lost.append("animation")
        elif kind not in _PNG_NEEDED:
            lost.append("a further chunk")
    found = PictureMetadata(
        icc=icc,
        depth=16 if depth == 16 else 8,
        has_alpha=has_alpha,
        png=tuple(shown.items()),
        lost=tuple(dict.fromkeys(lost)),
    )
    return with_exif(found, exif)


def grey_key(data: bytes) -> int | None:
    """The one transparent code of a grey PNG (tRNS), on the scale of the 8 or 16 bits it is decoded to, or None."""
    bits, color = data[24], data[25]
    key = next((body for kind, body in _chunks(data) if kind == b"tRNS"), None) if color == 0 else None
    if key is None or len(key) < 2:
        return None
    top = (1 << bits) - 1
    code = int.from_bytes(key[:2], "big") & top
    return code * 255 // top if bits < 8 else code


def _inflated(body: bytes) -> bytes:
    stream = zlib.decompressobj()
    try:
        return stream.decompress(body, MOST_ICC_BYTES)
    except zlib.error:
        return b""


def into_png(data: bytes, metadata: PictureMetadata) -> bytes:
    """An encoded PNG file with profile, EXIF and further chunks put in."""
    chunks = b"".join(_chunk(kind, body) for kind, body in metadata.png)
    if metadata.icc is not None:
        chunks += _chunk(b"iCCP", b"ICC profile\0\0" + zlib.compress(metadata.icc, 9))
    if metadata.exif is not None:
        chunks += _chunk(b"eXIf", metadata.exif)
    end = _PNG_SIGNATURE + 25  # all of these stand before the first IDAT, some before PLTE: right after IHDR
    return data[:end] + chunks + data[end:]


def png_size(data: bytes) -> tuple[int, int] | None:
    """(width, height); None when the file is cut short. Raises `struct.error`, `IndexError`, `TooManyPartsError`."""
    if data[8:16] != b"\0\0\0\x0dIHDR":
        return None
    width, height = struct.unpack(">II", data[16:24])
    return (width, height) if any(kind == b"IEND" for kind, _ in _chunks(data)) else None
