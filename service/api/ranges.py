"""Byte ranges and conditions of a download (RFC 9110, 13 and 14)."""

from __future__ import annotations

import re

from service.errors import PreconditionError, RangeError

# no file needs more digits, and Python refuses to read thousands of them
_RANGE = re.compile(r"bytes\s*+=\s*+(\d{0,20})\s*+-\s*+(\d{0,20})\s*+", re.IGNORECASE)


def parse_range(header: str | None, size: int) -> tuple[int, int] | None:
    """The requested bytes as [start, end), or None for the whole file.

    A header that is malformed or asks for several ranges is ignored, as the RFC allows. Raises `RangeError` when
    the range lies outside a file of ``size`` bytes.
    """
    found = _RANGE.fullmatch(header or "")
    if not found or not (found[1] or found[2]):
        return None
    outside = RangeError(f"the file has {size} bytes", headers={"Content-Range": f"bytes */{size}"})
    if not found[1]:
        length = int(found[2])
        if length == 0 or size == 0:
            raise outside
        return max(0, size - length), size
    start = int(found[1])
    if found[2] and int(found[2]) < start:
        return None
    if start >= size:
        raise outside
    return start, min(size, int(found[2]) + 1) if found[2] else size


def matches(header: str | None, etag: str, *, weak: bool = True) -> bool:
    """True when an If-None-Match (weak) or If-Range (strong) header names this entity tag."""
    if header is None:
        return False
    tags = [tag.strip() for tag in header.split(",")]
    if weak:
        return "*" in tags or etag in {tag.removeprefix("W/") for tag in tags}
    return tags == [etag]


def require_match(if_match: str | None, etag: str) -> None:
    """Raise `PreconditionError` when an If-Match (RFC 9110, 13.1.1) names neither this strong entity tag nor `*`."""
    if if_match is not None and not {tag.strip() for tag in if_match.split(",")} & {"*", etag}:
        raise PreconditionError(f"its ETag is {etag}, which If-Match does not name")
