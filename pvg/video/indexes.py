"""How much a demuxer would hold of a clip's headers, counted in the file before one opens it.

Demuxers make an entry in memory for every sample that an index names, and a few bytes can name millions: an MP4 of
3 kB made libav take 4.7 GB. Formats: ISO/IEC 14496-12 and Apple's QuickTime File Format (MP4, MOV), RFC 9559
(Matroska), OpenDML 1.02 (AVI).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from pvg.errors import MediaError
from pvg.video.sniffing import MOST_OUTER, Kind, iso_boxes

MOST_ENTRIES = 2_000_000
"""Samples that the indexes of all tracks together may name; two hours of pictures and sound have 800,000."""
_MOST_HEADER_BYTES = 64 * 2**20


def check_index(path: Path, kind: Kind) -> None:
    """Refuse a clip whose indexes name more than MOST_ENTRIES samples, or whose headers are as long as none needs.

    Pictures pass. Raises MediaError.
    """
    entries = index_entries(path, kind)
    if entries > MOST_ENTRIES:
        raise MediaError(f"{path.name} has an index of {entries} samples; at most {MOST_ENTRIES} are accepted")


def index_entries(path: Path, kind: Kind) -> int:
    """Samples that the indexes name: of an MP4 what libav would make entries of, of an AVI at least that, of other
    kinds 0. Raises MediaError for headers as long as none needs."""
    readers = {"mp4": _iso_entries, "matroska": _matroska_entries, "avi": _avi_entries}
    if kind not in readers:
        return 0
    with path.open("rb") as file:
        return readers[kind](path.name, file, path.stat().st_size)


# --- MP4, MOV -------------------------------------------------------------------------------------------------

_TABLES = re.compile(rb"stsz|stz2|trun")
_NOT_READ = (b"mdat", b"free", b"skip", b"wide", b"uuid")
_SOUND_SAMPLES_AN_ENTRY = 1024
_BESIDE_SOUND = {b"soun", b"alis", b"url ", b"rsrc"}  # handlers of a sound track: its own, and where its data are
_MOST_BOXES = 100_000


def _iso_entries(name: str, file: BinaryIO, size: int) -> int:
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
        if length > _MOST_HEADER_BYTES:
            what = kind.decode("latin-1")
            raise MediaError(f"{name} has a box {what!r} of {length} bytes; at most {_MOST_HEADER_BYTES} are accepted")
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


# --- Matroska -------------------------------------------------------------------------------------------------

SEGMENT, CLUSTER, _SEEK_HEAD, _ATTACHMENTS = (
    b"\x18\x53\x80\x67",
    b"\x1f\x43\xb6\x75",
    b"\x11\x4d\x9b\x74",
    b"\x19\x41\xa4\x69",
)
_HEADERS = (
    _SEEK_HEAD,
    b"\x15\x49\xa9\x66",
    b"\x16\x54\xae\x6b",
    b"\x1c\x53\xbb\x6b",
    b"\x10\x43\xa7\x70",
    b"\x12\x54\xc3\x67",
)
"""Elements of a segment that are read as a whole: SeekHead, Info, Tracks, Cues, Chapters, Tags."""
_OUTER = re.compile(b"|".join(map(re.escape, (SEGMENT, CLUSTER, _ATTACHMENTS, *_HEADERS))))
_SEEK_POSITION = b"\x53\xac"
_MOST_BYTES = {_ATTACHMENTS: _MOST_HEADER_BYTES, b"\x1c\x53\xbb\x6b": 8 * 2**20}
_MOST_OTHER_BYTES = 2**20
_MOST_LISTED = 1000


def _matroska_entries(name: str, file: BinaryIO, size: int) -> int:
    """Check how long the headers are: what a reader holds of them is in proportion. No samples are counted."""
    held = dict.fromkeys((*_HEADERS, _ATTACHMENTS), 0)
    segment, seen, sought = 0, set[int](), set[int]()

    def hold(identity: bytes, body: int, end: int) -> None:
        if identity not in held or body in seen:
            return
        seen.add(body)
        held[identity] += end - body
        if held[identity] > (most := _MOST_BYTES.get(identity, _MOST_OTHER_BYTES)):
            raise MediaError(f"{name} has headers of more than {most} bytes beside its pictures; export it again")
        if identity == _ATTACHMENTS:
            _check_attachments(name, file, body, end)

    for identity, body, end in _elements(name, file, 0, size):
        if identity == SEGMENT:
            segment = body
        hold(identity, body, min(end, size))
        if identity == _SEEK_HEAD:
            sought |= {segment + place for place in _sought(name, file, body, min(end, size))}
    for place in sought:  # it may lead into what is skipped above
        for identity, body, end in islice(_elements(name, file, place, size), 1):
            hold(identity, body, min(end, size))
    return 0


def _check_attachments(name: str, file: BinaryIO, body: int, end: int) -> None:
    if sum(1 for _ in islice(_elements(name, file, body, end), _MOST_LISTED + 1)) > _MOST_LISTED:
        raise MediaError(f"{name} has more than {_MOST_LISTED} attachments; save it without them")


def _elements(name: str, file: BinaryIO, at: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """(identity, body, end) of the elements one after the other; those inside a segment, or of unknown length, are
    entered. Past what is no element the next one of the outermost is looked for, as readers do."""
    number = 0
    while at < end:
        number += 1
        if number > MOST_OUTER:
            raise MediaError(f"{name} has more than {MOST_OUTER} outer elements; export it again")
        found = element_at(file, at)
        if found is None:
            at = next_outer(file, at + 1, end)
            continue
        identity, body, stop = found
        yield identity, body, end if stop is None else stop
        at = body if stop is None or identity == SEGMENT else stop


def element_at(file: BinaryIO, at: int) -> tuple[bytes, int, int | None] | None:
    """(identity, body, end) of the element that begins at a place, its end None when unknown; None for what is none."""
    file.seek(at)
    head = file.read(12)
    width = 9 - head[0].bit_length() if head and head[0] >= 16 else 0
    length, unknown, size_width = _length(head[width:]) if width else (0, False, 0)
    if not size_width:
        return None
    body = at + width + size_width
    return head[:width], body, None if unknown else body + length


def _length(data: bytes) -> tuple[int, bool, int]:
    """(value, whether it stands for "unknown", bytes read) of an EBML size; no bytes when there is none."""
    width = 9 - data[0].bit_length() if data and data[0] else 9
    if len(data) < width:
        return 0, False, 0
    value = int.from_bytes(data[:width], "big") & (1 << 7 * width) - 1
    return value, value == (1 << 7 * width) - 1, width


def next_outer(file: BinaryIO, at: int, end: int) -> int:
    """Where the next of the outermost elements begins; end where there is none."""
    step = 4096
    while at < end:
        file.seek(at)
        found = _OUTER.search(file.read(min(step, end - at)))
        if found:
            return at + found.start()
        at += step - 3
        step = min(2 * step, 2**20)
    return end


def _sought(name: str, file: BinaryIO, body: int, end: int) -> Iterator[int]:
    """Where the entries of a seek head lead, from the segment's start; a reader follows each."""
    file.seek(body)
    data = file.read(min(end - body, _MOST_OTHER_BYTES))
    places = list(re.finditer(re.escape(_SEEK_POSITION), data))
    if len(places) > _MOST_LISTED:
        raise MediaError(f"{name} has a list of {len(places)} headers; export it again")
    for found in places:
        length, _, width = _length(data[found.end() : found.end() + 8])
        start = found.end() + width
        yield int.from_bytes(data[start : start + min(length, 8)], "big")


# --- AVI ------------------------------------------------------------------------------------------------------

_MOST_CHUNKS = 100_000


def _avi_entries(name: str, file: BinaryIO, size: int) -> int:
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
