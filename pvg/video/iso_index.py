"""Samples that the index of an MP4 or a MOV names, as libav would make entries of them.

Formats: ISO/IEC 14496-12 and Apple's QuickTime File Format.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO

from pvg.errors import MediaError
from pvg.video.sniffing import MOST_OUTER, iso_boxes

_TABLES = re.compile(rb"stsz|stz2|trun")
_NOT_READ = (b"mdat", b"free", b"skip", b"wide", b"uuid")
_SOUND_SAMPLES_AN_ENTRY = 1024
_BESIDE_SOUND = {b"soun", b"alis", b"url ", b"rsrc"}  # handlers of a sound track: its own, and where its data are
_MOST_BOXES = 100_000
_MOST_BOX_BYTES = 64 * 2**20


def count_samples(name: str, file: BinaryIO, size: int) -> int:
    """Samples that the boxes outside of `mdat` name.

    A table counts wherever its four letters stand: libav reads it in any box, not only where it belongs.
    """
    entries = 0
    for number, (kind, body, end) in enumerate(iso_boxes(file, 0, size)):
        if number >= MOST_OUTER:
            raise MediaError(f"{name} has more than {MOST_OUTER} outer boxes; export it again")
        length = min(end, size) - body
        file.seek(body)
        # libav takes a free box that begins as an index does for one
        if kind in _NOT_READ and (kind == b"mdat" or file.read(8)[4:] not in (b"mvhd", b"cmov")):
            continue
        if length > _MOST_BOX_BYTES:
            what = kind.decode("latin-1")
            raise MediaError(f"{name} has a box {what!r} of {length} bytes; at most {_MOST_BOX_BYTES} are accepted")
        file.seek(body)
        data = file.read(length)
        entries += _of_index(name, data) if kind == b"moov" else _of_tables(name, data)
    return entries


def _of_index(name: str, moov: bytes) -> int:
    entries, at = 0, 0
    for kind, body, end in _children(name, moov, 0, len(moov)):
        # covers are bytes of any kind, and only they are
        rest = _without_covers(name, moov[body:end]) if kind == b"udta" else moov[at:end]
        entries += _of_sound(rest) if kind == b"trak" and _is_plain_sound(rest) else _of_tables(name, rest)
        at = end
    return entries + _of_tables(name, moov[at:])


def _children(name: str, data: bytes, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    for number, (kind, body, stop) in enumerate(iso_boxes(BytesIO(data), start, end)):
        if number >= _MOST_BOXES:
            raise MediaError(f"{name} has an index of more than {_MOST_BOXES} boxes; export it again")
        yield kind, body, min(stop, end)


def _without_covers(name: str, data: bytes) -> bytes:
    """The bytes of a `udta` box less those of pictures in its meta, ilst, covr."""
    at, end = 0, len(data)
    for wanted, skip in ((b"meta", 4), (b"ilst", 0), (b"covr", 0)):
        found = next((box for box in _children(name, data, at, end) if box[0] == wanted), None)
        if found is None:
            return data
        at, end = found[1] + skip, found[2]
    return data[:at] + data[end:]


def _of_tables(name: str, data: bytes) -> int:
    """Samples by the heads of all tables: version and flags, the size of all samples (not in `trun`), the count.

    Raises MediaError where a compressed index could be, which demuxers inflate in any box.
    """
    if b"cmov" in data:
        raise MediaError(f"{name} has a compressed index, as old QuickTime files may; export it again")
    entries = 0
    for found in _TABLES.finditer(data):
        at = found.end() + (4 if found[0] == b"trun" else 8)
        entries += int.from_bytes(data[at : at + 4], "big")
    return entries


def _is_plain_sound(trak: bytes) -> bool:
    """Whether a track is sound whose samples are all of one size and a tick long, so that libav counts in chunks."""
    kinds = {trak[found.end() + 8 : found.end() + 12] for found in re.finditer(rb"hdlr", trak)}
    if b"soun" not in kinds or kinds - _BESIDE_SOUND or b"cmov" in trak:
        return False
    if any(trak.count(table) != 1 for table in (b"stts", b"stsc", b"stsz")):
        return False
    if trak.count(b"stco") + trak.count(b"co64") != 1 or b"trun" in trak or b"stz2" in trak:
        return False
    times = trak.index(b"stts") + 8
    return trak[times : times + 4] == b"\0\0\0\1" and trak[times + 8 : times + 12] == b"\0\0\0\1"


def _of_sound(trak: bytes) -> int:
    """Entries that libav makes of plain sound: one for each chunk, and more for long chunks."""
    chunks = int.from_bytes(trak[(at := max(trak.find(b"stco"), trak.find(b"co64")) + 8) : at + 4], "big")
    at = trak.index(b"stsc") + 12
    runs = min(int.from_bytes(trak[at - 4 : at], "big"), (len(trak) - at) // 12)
    heads = [struct.unpack_from(">II", trak, at + 12 * k) for k in range(runs)]
    ends = [first for first, _ in heads[1:]] + [chunks + 1]
    return sum(
        max(0, end - first) * -(-samples // _SOUND_SAMPLES_AN_ENTRY)
        for (first, samples), end in zip(heads, ends, strict=True)
    )
