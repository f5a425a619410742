"""Image file directories: the lists of tags that TIFF pictures and EXIF blocks are made of (TIFF 6.0, section 2)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

SHORT, LONG, UNDEFINED = 3, 4, 7
_UNIT = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 1, 7: 1, 8: 2, 9: 4, 10: 4, 11: 4, 12: 8, 13: 4}  # type -> bytes to swap
_SIZE = _UNIT | {5: 8, 10: 8}  # type -> bytes a value
_WHOLE_NUMBERS = {1: "B", SHORT: "H", LONG: "I", 13: "I"}
_MOST_ENTRIES = 4096
_MOST_NUMBERS = 1 << 20  # strips or tiles of a picture
HEADER = b"II*\0"
"""What a block written here begins with: least significant byte first."""


@dataclass(frozen=True)
class Entry:
    """One tag: its type (TIFF 6.0: 3 short, 4 long, …), how many values, and these, little-endian."""

    type: int
    count: int
    body: bytes

    def numbers(self) -> tuple[int, ...]:
        """The values of an entry of whole numbers; none for another type. Raises ValueError for absurdly many."""
        code = _WHOLE_NUMBERS.get(self.type)
        if code and self.count > _MOST_NUMBERS:
            raise ValueError(f"a tag has {self.count} values")
        return struct.unpack(f"<{self.count}{code}", self.body) if code else ()


Directory = dict[int, Entry]


def shorts(*values: int) -> Entry:
    """An entry of 16-bit numbers."""
    return Entry(SHORT, len(values), struct.pack(f"<{len(values)}H", *values))


def longs(values: Iterable[int]) -> Entry:
    """An entry of 32-bit numbers."""
    numbers = tuple(values)
    return Entry(LONG, len(numbers), struct.pack(f"<{len(numbers)}I", *numbers))


def opaque(body: bytes) -> Entry:
    """An entry of bytes that only its tag explains."""
    return Entry(UNDEFINED, len(body), body)


class Block:
    """A TIFF file or EXIF block (without its "Exif" prefix) as it lies in memory.

    Raises ValueError for one that is no such block, and in `directory` for offsets that lie outside it.
    """

    def __init__(self, data: bytes) -> None:
        if data[:4] not in (HEADER, b"MM\0*") or len(data) < 8:
            raise ValueError("no TIFF header")
        self._data = data
        self._order = "<" if data[:2] == b"II" else ">"

    @property
    def first(self) -> int:
        """Where the first directory lies."""
        return int(struct.unpack_from(self._order + "I", self._data, 4)[0])

    def directory(self, at: int) -> tuple[Directory, int]:
        """The tags of the directory at an offset, those of unknown types left out, and where the next one lies (0:
        there is none)."""
        order, data = self._order, self._data
        try:
            (count,) = struct.unpack_from(order + "H", data, at)
            if count > _MOST_ENTRIES or at < 8:
                raise ValueError("a directory is damaged")
            entries: Directory = {}
            held = 0
            for k in range(count):
                tag, kind, values = struct.unpack_from(order + "HHI", data, at + 2 + 12 * k)
                if kind not in _SIZE:
                    continue
                length, place = values * _SIZE[kind], at + 2 + 12 * k + 8
                if length > 4:
                    (place,) = struct.unpack_from(order + "I", data, place)
                held += length
                if place + length > len(data):
                    raise ValueError(f"tag {tag} lies outside the file")
                if held > len(data):  # values that share their bytes would fill the memory
                    raise ValueError("a directory claims more than the file has")
                entries[tag] = Entry(kind, values, self._swapped(data[place : place + length], _UNIT[kind]))
            after = at + 2 + 12 * count
            following = struct.unpack_from(order + "I", data, after)[0] if after + 4 <= len(data) else 0
        except struct.error as error:
            raise ValueError("a directory is cut short") from error
        return entries, int(following)

    def place_of(self, at: int, tag: int) -> int | None:
        """Where the value field of a tag lies in the directory at an offset; None when there is no such tag."""
        (count,) = struct.unpack_from(self._order + "H", self._data, at)
        for k in range(min(count, _MOST_ENTRIES)):
            place = at + 2 + 12 * k
            if struct.unpack_from(self._order + "H", self._data, place)[0] == tag:
                return place + 8
        return None

    def _swapped(self, body: bytes, unit: int) -> bytes:
        if self._order == "<" or unit == 1:
            return body
        return np.frombuffer(body, f">u{unit}").astype(f"<u{unit}").tobytes()


def numbers_of(directory: Mapping[int, Entry], tag: int, default: tuple[int, ...] = ()) -> tuple[int, ...]:
    """The whole numbers of a tag, or the default where it is missing or of another type."""
    entry = directory.get(tag)
    return (entry.numbers() or default) if entry is not None else default


def written(directory: Mapping[int, Entry], children: Mapping[int, Mapping[int, Entry]], start: int) -> bytes:
    """A directory as it stands at the even offset `start` of a block, with its values and child directories after it.

    children: directories by the tag that points to them. No directory follows it.
    """
    tags = sorted({*directory, *children})
    fields, tail = [], b""
    after = start + 2 + 12 * len(tags) + 4
    for tag in tags:
        if tag in children:
            place = after + len(tail)
            tail += written(children[tag], {}, place)
            fields.append(struct.pack("<HHII", tag, LONG, 1, place))
            continue
        entry = directory[tag]
        field = struct.pack("<HHI", tag, entry.type, entry.count)
        if len(entry.body) <= 4:
            fields.append(field + entry.body.ljust(4, b"\0"))
        else:
            fields.append(field + struct.pack("<I", after + len(tail)))
            tail += entry.body + b"\0" * (len(entry.body) % 2)
    return struct.pack("<H", len(tags)) + b"".join(fields) + b"\0\0\0\0" + tail
