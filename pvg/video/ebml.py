"""Elements of a Matroska file: what they are called, where they begin and where they end (RFC 8794, RFC 9559)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO

from pvg.errors import MediaError
from pvg.video.sniffing import MOST_OUTER

SEGMENT = b"\x18\x53\x80\x67"
CLUSTER = b"\x1f\x43\xb6\x75"
SEEK_HEAD = b"\x11\x4d\x9b\x74"
SEEK_POSITION = b"\x53\xac"
INFO = b"\x15\x49\xa9\x66"
TRACKS = b"\x16\x54\xae\x6b"
CUES = b"\x1c\x53\xbb\x6b"
CHAPTERS = b"\x10\x43\xa7\x70"
TAGS = b"\x12\x54\xc3\x67"
ATTACHMENTS = b"\x19\x41\xa4\x69"
IN_SEGMENT = (SEEK_HEAD, INFO, TRACKS, CUES, CHAPTERS, TAGS, ATTACHMENTS)
"""What a segment holds beside its clusters: a reader reads each as a whole."""
_OUTER = re.compile(b"|".join(map(re.escape, (SEGMENT, CLUSTER, *IN_SEGMENT))))


def elements(name: str, file: BinaryIO, at: int, end: int) -> Iterator[tuple[bytes, int, int]]:
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
    length, unknown, size_width = length_of(head[width:]) if width else (0, False, 0)
    if not size_width:
        return None
    body = at + width + size_width
    return head[:width], body, None if unknown else body + length


def length_of(data: bytes) -> tuple[int, bool, int]:
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
