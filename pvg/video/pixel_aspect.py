"""The shape of a Matroska or WebM file's pixels (RFC 9559): PyAV gives libav's muxer no way to say it.

It is said by the size at which pictures are shown, in the description of their track. libav leaves room (a Void
element) between the list of a file's parts and the first of them; all from there to that description moves forward by
what is added to it, and what comes after stays where it is.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from pvg.errors import MediaError
from pvg.video.ebml import INFO, SEEK_HEAD, SEEK_POSITION, SEGMENT, TRACKS

_VOID, _SOUGHT, _CHECKSUM = b"\xec", b"\x4d\xbb", b"\xbf"
_TRACK, _VIDEO, _WIDTH, _HEIGHT = b"\xae", b"\xe0", b"\xb0", b"\xba"
_SHOWN_WIDTH, _SHOWN_HEIGHT, _SHOWN_UNIT = b"\x54\xb0", b"\x54\xba", b"\x54\xb2"


@dataclass(frozen=True)
class _Element:
    """An element's identity, how many bytes its length takes, and its body."""

    identity: bytes
    width: int
    body: bytes

    @property
    def size(self) -> int:
        """Bytes of all of it."""
        return len(self.identity) + self.width + len(self.body)

    def written(self) -> bytes:
        """All of it."""
        return self.identity + (len(self.body) | 1 << 7 * self.width).to_bytes(self.width, "big") + self.body

    def holding(self, parts: Sequence[_Element]) -> _Element:
        """The same with these in it, and its checksum mended, if it has one."""
        first = parts[0]
        if first.identity == _CHECKSUM:
            crc = zlib.crc32(b"".join(part.written() for part in parts[1:]))
            parts = (replace(first, body=crc.to_bytes(4, "little")), *parts[1:])
        body = b"".join(part.written() for part in parts)
        least = -(-(len(body) + 2).bit_length() // 7)  # a length of ones alone stands for "unknown"
        return _Element(self.identity, max(self.width, least), body)

    def with_first(self, identity: bytes, change: Callable[[_Element], _Element]) -> _Element:
        """The same with the first of its elements of this identity changed."""
        parts = _elements(self.body)
        at = next(at for at, part in enumerate(parts) if part.identity == identity)
        return self.holding([*parts[:at], change(parts[at]), *parts[at + 1 :]])


def say_pixel_aspect(path: Path, aspect: Fraction) -> None:
    """Have a finished file of libav's Matroska muxer say that its pixels are so many times as wide as high.

    The pictures are its first track. The size at which they are shown is in whole pixels: where neither side comes out
    whole it is off by half of one at most. Raises MediaError for a file that is made otherwise.
    """
    with path.open("r+b") as file:
        _read(file)  # what kind of file it is; then the segment, which is all the rest
        if _vint(file) != SEGMENT:
            raise MediaError(f"{path.name}: it is not as libav's muxer makes it")
        _vint(file)
        begin = file.tell()
        parts = [_read(file) for _ in range(4)]
        listed, void, info, tracks = parts
        if [part.identity for part in parts] != [SEEK_HEAD, _VOID, INFO, TRACKS]:
            raise MediaError(f"{path.name}: it is not as libav's muxer makes it")
        said = tracks.with_first(_TRACK, lambda track: track.with_first(_VIDEO, lambda video: _shown(video, aspect)))
        more = said.size - tracks.size
        if more > len(void.body):
            raise MediaError(f"{path.name}: its headers have no room for the shape of its pixels")
        moving = range(listed.size + void.size, sum(part.size for part in parts))
        left = replace(void, body=void.body[more:])
        made = (_moved(listed, moving, more), left, info, said)
        file.seek(begin)
        file.write(b"".join(part.written() for part in made))


def _shown(video: _Element, aspect: Fraction) -> _Element:
    parts = _elements(video.body)
    width, height = (
        next(int.from_bytes(part.body, "big") for part in parts if part.identity == name) for name in (_WIDTH, _HEIGHT)
    )
    wider, higher = (width * aspect, Fraction(height)), (Fraction(width), height / aspect)
    sizes = (wider, higher) if aspect > 1 else (higher, wider)  # none is lost where the pictures are shown larger
    size = next((one for one in sizes if all(side.denominator == 1 for side in one)), sizes[0])
    others = [part for part in parts if part.identity not in (_SHOWN_WIDTH, _SHOWN_HEIGHT, _SHOWN_UNIT)]
    names = (_SHOWN_WIDTH, _SHOWN_HEIGHT)
    return video.holding([*others, *(_number(name, round(side)) for name, side in zip(names, size, strict=True))])


def _number(identity: bytes, value: int) -> _Element:
    return _Element(identity, 1, value.to_bytes(-(-value.bit_length() // 8), "big"))


def _moved(listed: _Element, moving: range, by: int) -> _Element:
    """The list of a file's parts once those in this range lie further ahead."""

    def mended(entry: _Element) -> _Element:
        def place(old: _Element) -> _Element:
            at = int.from_bytes(old.body, "big")
            return replace(old, body=(at - by).to_bytes(len(old.body), "big")) if at in moving else old

        return entry.with_first(SEEK_POSITION, place) if entry.identity == _SOUGHT else entry

    return listed.holding([mended(entry) for entry in _elements(listed.body)])


def _elements(data: bytes) -> list[_Element]:
    file, found = BytesIO(data), list[_Element]()
    while file.tell() < len(data):
        found.append(_read(file))
    return found


def _read(file: BinaryIO) -> _Element:
    identity = _vint(file)
    length = _vint(file)
    size = int.from_bytes(length, "big") & (1 << 7 * len(length)) - 1
    return _Element(identity, len(length), file.read(size))


def _vint(file: BinaryIO) -> bytes:
    """The bytes of an identity or a length, whose first one tells how many they are."""
    first = file.read(1)
    return first + file.read(8 - first[0].bit_length()) if first and first[0] else b""
