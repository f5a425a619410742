"""What a file is, told by its bytes alone, and what its headers claim, read before any decoder sees them."""

from __future__ import annotations

import stat
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Literal

from pvg.errors import MediaError, TooLargeError

Kind = Literal["mp4", "matroska", "avi", "jpeg", "png", "webp", "tiff"]

IMAGE_KINDS = frozenset({"jpeg", "png", "webp", "tiff"})
ACCEPTED = "accepted are MP4, MOV, WebM, MKV and AVI clips and JPEG, PNG, TIFF and still WebP pictures"

_ISO_FIRST_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot", b"styp")
_HEIF_BRANDS = (b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif", b"avis", b"crx ")
_KNOWN_STARTS = (
    (b"GIF8", "a GIF"),
    (b"#EXTM3U", "an HLS playlist"),
    (b"ffconcat", "an ffconcat script"),
    (b"[playlist]", "a playlist"),
    (b"<svg", "an SVG drawing"),
    (b"<?xml", "an XML document"),
    (b"<!DOCTYPE", "an HTML or XML document"),
    (b"<html", "an HTML document"),
    (b"%PDF", "a PDF"),
    (b"BM", "a BMP picture"),
    (b"II+\0", "a BigTIFF picture"),
    (b"MM\0+", "a BigTIFF picture"),
    (b"PK\x03\x04", "a ZIP archive, or an asset, which `pvg.open_asset` opens"),
    (b"ID3", "an MP3 sound file"),
    (b"\xff\xfb", "an MP3 sound file"),
    (b"OggS", "an Ogg file"),
    (b"fLaC", "a FLAC sound file"),
    (b"FLV", "a Flash video"),
    (b"\x30\x26\xb2\x75", "a Windows Media file"),
    (b"\0\0\x01\xba", "an MPEG program stream"),
    (b"\0\0\x01\xb3", "an MPEG elementary stream"),
    (b"\x47", "an MPEG transport stream"),
)


MOST_OUTER = 500_000
"""The most outermost boxes or elements of a file: fragments, clusters; in live recordings every block."""


def sniff(path: str | Path) -> Kind:
    """The kind of a file by its first bytes; its name plays no part.

    Raises MediaError that says what the file is, where known, and what is accepted.
    """
    path = Path(path)
    head = _read_head(path)
    kind = _accepted_kind(head)
    if kind is None:
        raise MediaError(f"{path.name} is {_describe(head)}; {ACCEPTED}")
    return kind


def _read_head(path: Path) -> bytes:
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise MediaError(f"{path} is not a file")
        with path.open("rb") as file:
            return file.read(4096)
    except (FileNotFoundError, NotADirectoryError, ValueError) as error:  # the last: a zero byte in it
        raise MediaError(f"{path} does not exist") from error
    except OSError as error:
        raise MediaError(f"{path} cannot be read: {error.strerror}") from error


def _accepted_kind(head: bytes) -> Kind | None:
    tag = head[8:12]
    kind: Kind | None = None
    if head[4:8] in _ISO_FIRST_BOXES:
        kind = None if head[4:8] == b"ftyp" and tag in _HEIF_BRANDS else "mp4"
    elif head.startswith(b"\x1a\x45\xdf\xa3"):
        kind = "matroska"
    elif head.startswith(b"RIFF") and tag == b"AVI ":
        kind = "avi"
    elif head.startswith(b"\xff\xd8\xff"):
        kind = "jpeg"
    elif head.startswith(b"\x89PNG\r\n\x1a\n"):
        kind = "png"
    elif head.startswith((b"II*\0", b"MM\0*")):
        kind = "tiff"
    elif head.startswith(b"RIFF") and tag == b"WEBP":
        # bit 1 of the VP8X flags: animation
        kind = None if head[12:16] == b"VP8X" and len(head) > 20 and head[20] & 2 else "webp"
    return kind


def _describe(head: bytes) -> str:
    if not head:
        return "empty"
    if head[4:8] == b"ftyp":
        return "a HEIF or AVIF picture"
    if head.startswith(b"RIFF"):
        return {b"WAVE": "a WAV sound file", b"WEBP": "an animated WebP"}.get(head[8:12], "an unknown RIFF file")
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    for start, name in _KNOWN_STARTS:
        if head.startswith(start) or (len(start) > 3 and text[: len(start)].lower() == start.lower()):
            return name
    if not any(byte < 9 or 13 < byte < 32 for byte in head):
        return "a text file"
    return "of no known kind"


# --- ISO base media (MP4, MOV) -------------------------------------------------------------------------------

_ISO_FOLDERS = (b"moov", b"trak", b"mdia", b"minf", b"dinf", b"stbl")
_MOST_DEPTH, _MOST_BOXES = 10, 100_000


def check_structure(path: Path, kind: Kind, max_pixels: int) -> None:
    """Refuse, before a demuxer opens it, a clip whose headers do not fit the file or the limits.

    Checked are: an MP4 has its index, and all of it; MP4 sample tables live in this file only; no MP4 track declares
    more than max_pixels. Raises MediaError. What is cut off behind its index passes; see `claimed_bytes`.
    """
    if kind == "mp4":
        with path.open("rb") as file:
            _check_iso(path.name, file, path.stat().st_size, max_pixels)


_UNKNOWN_RIFF_SIZE = 0xFFFFFFFF  # of a writer that cannot go back to its header


def claimed_bytes(path: Path, kind: Kind) -> int:
    """How long a clip ought to be by its outer boxes, RIFF header or segment: more than it has when it is cut short.

    A Matroska or AVI file that was recorded live does not say; nor does an MP4 whose last box runs to the end of the
    file.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if kind == "mp4":
            return max((end for box, _, end in iso_boxes(file, 0, size) if box in (b"mdat", b"moof")), default=size)
        if kind == "matroska":
            return _segment_end(file) or size
        head = file.read(8)
        claim = int(struct.unpack("<I", head[4:])[0]) if len(head) == 8 else 0
        # the last pad byte of a RIFF file may be left out
        return size if claim in (0, _UNKNOWN_RIFF_SIZE) else 7 + claim


def is_fragmented(path: Path, kind: Kind) -> bool:
    """Whether an MP4 goes on in fragments, whose frames its index does not count."""
    if kind != "mp4":
        return False
    with path.open("rb") as file:
        return any(box == b"moof" for box, _, _ in iso_boxes(file, 0, path.stat().st_size))


def cut_short(name: str, claimed: int, size: int) -> MediaError:
    """The refusal of a file that ends before it should."""
    return MediaError(f"{name} is cut short: its header claims {claimed} bytes, the file has {size}; upload it whole")


def iso_boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """(type, body start, box end) of the boxes in file[start:end]; an end may lie outside."""
    while start + 8 <= end:
        file.seek(start)
        head = file.read(8)
        if len(head) < 8:  # the end that was said lies behind the file's
            return
        size, kind = struct.unpack(">I4s", head)
        body = start + 8
        if size == 1:
            size = struct.unpack(">Q", file.read(8).ljust(8, b"\0"))[0]
            body += 8
        elif size == 0:
            size = end - start
        if size < body - start:
            return
        yield kind, body, start + size
        start += size


def _check_iso(name: str, file: BinaryIO, size: int, max_pixels: int) -> None:
    seen = set()
    for number, (kind, body, end) in enumerate(iso_boxes(file, 0, size)):
        if number >= MOST_OUTER:
            raise MediaError(f"{name} has more than {MOST_OUTER} outer boxes; export it again")
        seen.add(kind)
        if kind == b"moov":
            if end > size:
                raise cut_short(name, end, size)
            _check_moov(name, file, body, end, max_pixels)
    if b"moov" not in seen:
        raise MediaError(f"{name} has no index (moov box): the recording was not finished; export it again")


def _check_moov(name: str, file: BinaryIO, start: int, end: int, max_pixels: int) -> None:
    handler = b""  # mdia orders hdlr before minf
    stack, number = [iso_boxes(file, start, end)], 0
    while stack:
        box = next(stack[-1], None)
        if box is None:
            stack.pop()
            continue
        kind, body, stop = box
        number += 1
        if len(stack) > _MOST_DEPTH or number > _MOST_BOXES:
            raise MediaError(f"{name} has an index of boxes too many or too deep in each other; export it again")
        if kind in _ISO_FOLDERS:
            stack.append(iso_boxes(file, body, min(stop, end)))
        elif kind == b"hdlr":
            file.seek(body + 8)
            found = file.read(4)
            handler = found if found in (b"vide", b"soun") or len(stack) > 3 else handler
        elif kind == b"dref":
            _check_references(name, file, body, min(stop, end))
        elif kind == b"stsd" and handler == b"vide":
            _check_declared_size(name, file, body, min(stop, end), max_pixels)


def _check_references(name: str, file: BinaryIO, body: int, end: int) -> None:
    for _, entry, _ in iso_boxes(file, body + 8, end):
        file.seek(entry)
        flags = file.read(4)
        if len(flags) == 4 and not flags[3] & 1:  # flag 1: the data is in this file
            raise MediaError(f"{name} keeps its data in another file or address; export it as one self-contained file")


def _check_declared_size(name: str, file: BinaryIO, body: int, end: int, max_pixels: int) -> None:
    for _, entry, _ in iso_boxes(file, body + 8, end):
        file.seek(entry + 24)
        raw = file.read(4)
        width, height = struct.unpack(">HH", raw) if len(raw) == 4 else (0, 0)
        check_pixels(name, width, height, max_pixels)


def check_pixels(name: str, width: int, height: int, max_pixels: int) -> None:
    """Raise TooLargeError when a picture of this size is over the limit."""
    if width * height > max_pixels:
        raise TooLargeError(
            f"{name} is {width}x{height} = {width * height} pixels; at most {max_pixels} are accepted, scale it down",
            max_pixels,
            "pixels",
        )


# --- Matroska -------------------------------------------------------------------------------------------------


def _segment_end(file: BinaryIO) -> int | None:
    """Where the segment claims to end; None when it does not say (a live recording)."""
    file.seek(4)
    header = _vint(file)
    if header is None:
        return None
    file.seek(header, 1)
    if file.read(4) != b"\x18\x53\x80\x67":
        return None
    length = _vint(file)
    return None if length is None else file.tell() + length


def _vint(file: BinaryIO) -> int | None:
    """An EBML size; None when it is the reserved "unknown" value or not there."""
    first = file.read(1)
    if not first or not first[0]:
        return None
    length = 9 - first[0].bit_length()
    value = int.from_bytes(bytes([first[0] & (0xFF >> length)]) + file.read(length - 1), "big")
    return None if value == (1 << (7 * length)) - 1 else value
