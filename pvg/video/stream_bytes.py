"""Bytes that come by a stream, as many as are asked for."""

from __future__ import annotations

from typing import BinaryIO

_LONGEST_LINE = 4096


def exactly(source: BinaryIO, size: int, *, short: bool = False) -> bytes:
    """`size` bytes; fewer only when `short` is allowed, else none where the stream ends before."""
    parts: list[bytes] = []
    left = size
    while left:
        part = source.read(left)
        if not part:
            return b"".join(parts) if short else b""
        parts.append(part)
        left -= len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def line(source: BinaryIO) -> bytes:
    """The bytes up to the end of the line, and it; empty at the end of the stream."""
    found = bytearray()
    while len(found) < _LONGEST_LINE:
        byte = source.read(1)
        found += byte
        if not byte or byte == b"\n":
            break
    return bytes(found)
