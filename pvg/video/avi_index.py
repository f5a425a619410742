"""Frames that the indexes of an AVI name (OpenDML 1.02)."""

from __future__ import annotations

import struct
from typing import BinaryIO

from pvg.errors import MediaError

_MOST_CHUNKS = 100_000


def count_frames(name: str, file: BinaryIO, size: int) -> int:
    """Frames that the old index and the indexes of indexes of an AVI name."""
    entries = at = number = 0
    while at + 12 <= size:
        number += 1
        if number > _MOST_CHUNKS:
            raise MediaError(f"{name} has more than {_MOST_CHUNKS} outer chunks; export it again")
        file.seek(at)
        kind, length, form = struct.unpack("<4sI4s", file.read(12))
        if kind == b"idx1":
            entries += length // 16
        elif kind == b"indx":
            entries += _of_indexes(name, file, at + 8, min(length, size - at - 8), size)
        if kind in (b"RIFF", b"LIST") and form != b"movi":
            at += 12
        else:
            at += 8 + length + length % 2
    return entries


def _of_indexes(name: str, file: BinaryIO, body: int, length: int, size: int) -> int:
    file.seek(body)
    data = file.read(length)
    if len(data) < 24:
        return 0
    deep, count = data[3], struct.unpack_from("<I", data, 4)[0]
    if deep:  # a list of frames
        return min(int(count), len(data) // 8)
    entries = 0
    for k in range(min(count, (len(data) - 24) // 16)):
        at = struct.unpack_from("<Q", data, 24 + 16 * k)[0]
        if at >= size:
            continue
        file.seek(at)
        head = file.read(16)
        if len(head) == 16 and not head[11]:
            raise MediaError(f"{name} has an index of indexes of indexes; export it again")
        entries += int.from_bytes(head[12:], "little")
    return entries
