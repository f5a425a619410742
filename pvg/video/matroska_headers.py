"""How long the headers of a Matroska file are: what a reader holds of them is in proportion (RFC 9559)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from typing import BinaryIO

from pvg.errors import MediaError
from pvg.video.ebml import ATTACHMENTS, CUES, IN_SEGMENT, SEEK_HEAD, SEEK_POSITION, SEGMENT, elements, length_of

_MOST_BYTES = {ATTACHMENTS: 64 * 2**20, CUES: 8 * 2**20}
_MOST_OTHER_BYTES = 2**20
_MOST_LISTED = 1000


def check_headers(name: str, file: BinaryIO, size: int) -> None:
    """Refuse headers longer than any clip needs, by their kind. Raises MediaError."""
    held = dict.fromkeys(IN_SEGMENT, 0)
    segment, seen, sought = 0, set[int](), set[int]()

    def hold(identity: bytes, body: int, end: int) -> None:
        if identity not in held or body in seen:
            return
        seen.add(body)
        held[identity] += end - body
        if held[identity] > (most := _MOST_BYTES.get(identity, _MOST_OTHER_BYTES)):
            raise MediaError(f"{name} has headers of more than {most} bytes beside its pictures; export it again")
        if identity == ATTACHMENTS:
            _check_attachments(name, file, body, end)

    for identity, body, end in elements(name, file, 0, size):
        if identity == SEGMENT:
            segment = body
        hold(identity, body, min(end, size))
        if identity == SEEK_HEAD:
            sought |= {segment + place for place in _sought(name, file, body, min(end, size))}
    for place in sought:  # it may lead into what is skipped above
        for identity, body, end in islice(elements(name, file, place, size), 1):
            hold(identity, body, min(end, size))


def _check_attachments(name: str, file: BinaryIO, body: int, end: int) -> None:
    if sum(1 for _ in islice(elements(name, file, body, end), _MOST_LISTED + 1)) > _MOST_LISTED:
        raise MediaError(f"{name} has more than {_MOST_LISTED} attachments; save it without them")


def _sought(name: str, file: BinaryIO, body: int, end: int) -> Iterator[int]:
    """Where the entries of a seek head lead, from the segment's start; a reader follows each."""
    file.seek(body)
    data = file.read(min(end - body, _MOST_OTHER_BYTES))
    places = list(re.finditer(re.escape(SEEK_POSITION), data))
    if len(places) > _MOST_LISTED:
        raise MediaError(f"{name} has a list of {len(places)} headers; export it again")
    for found in places:
        length, _, width = length_of(data[found.end() : found.end() + 8])
        start = found.end() + width
        yield int.from_bytes(data[start : start + min(length, 8)], "big")
