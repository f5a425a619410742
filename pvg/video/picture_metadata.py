"""What a still picture carries beside its samples: colour profile and EXIF, found in a file and put into another.

PNG: W3C Portable Network Graphics, third edition (iCCP, eXIf). JPEG: ITU-T T.81 with ICC.1 annex B.4 (APP2) and CIPA
DC-008 (APP1). WebP: RFC 9649 (VP8X, ICCP, EXIF). TIFF: 6.0, with tag 34675 of ICC.1 annex B.4.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from pvg.errors import MediaError
from pvg.video.exif import read_exif
from pvg.video.ifd import Block
from pvg.video.sniffing import IMAGE_KINDS, sniff
from pvg.video.tiff import ICC_TAG, tiff_header

MOST_PARTS = 100_000
"""Chunks or segments of a picture; an encoder makes some hundreds at most."""
_MOST_ICC_BYTES = 16 * 2**20
_MOST_JPEG_EXIF_BYTES = 65535 - 2 - 6
JPEG_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of the segments that say a JPEG's size and its components."""
_INKS = 4
_ICC_SEGMENT = b"ICC_PROFILE\0"
_EXIF_SEGMENT = b"Exif\0\0"
_JFIF_SEGMENT = b"JFIF\0"
_DENSITY, _NO_DENSITY = slice(7, 12), b"\0\0\1\0\1"
_XMP_SEGMENTS = (b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0")
_STANDALONE = {0x01, *range(0xD0, 0xD9)}
_PNG_SIGNATURE = 8
_PNG_COLOR = {b"cICP", b"mDCV", b"cLLI", b"gAMA", b"cHRM", b"sRGB", b"pHYs"}
_PNG_TEXT = {b"tEXt", b"zTXt", b"iTXt"}
_PNG_NEEDED = {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"iCCP", b"eXIf", b"bKGD", b"hIST", b"sBIT", b"tIME"}
_ALPHA_SUFFIXES = (".png", ".webp", ".tif", ".tiff")
_DEEP_SUFFIXES = (".png", ".tif", ".tiff")


class TooManyPartsError(ValueError):
    """A picture is made of more parts than any encoder makes; says how many."""


@dataclass(frozen=True)
class PictureMetadata:
    """What a picture carries beside its samples.

    icc: the embedded colour profile as it stands (ICC.1), None without one. exif: the EXIF block (TIFF header first,
    no "Exif" prefix) that a drawn picture keeps: without location, thumbnail and maker's note, orientation 1.
    orientation: 1 to 8 as the file states it (TIFF 6.0, tag 274). depth: bits a sample, 8 or 16; grey and palettes
    count as 8 below. has_alpha: whether the file has a way of transparency. png: chunks of a PNG that say how it is to
    be shown (cICP, mDCV, cLLI, gAMA, cHRM, sRGB, pHYs), as (type, body), kept in PNG only. density: of a JPEG's pixels,
    unit and both numbers as JFIF (ISO/IEC 10918-5) has them, kept in JPEG only. lost: what the file
    holds that no drawn picture keeps, in words: "location", "thumbnail", "XMP", …
    """

    icc: bytes | None = None
    exif: bytes | None = None
    orientation: int = 1
    depth: int = 8
    has_alpha: bool = False
    png: tuple[tuple[bytes, bytes], ...] = ()
    density: bytes | None = None
    lost: tuple[str, ...] = ()


def read_picture_metadata(path: str | Path) -> PictureMetadata:
    """Read profile and EXIF of a JPEG, PNG, WebP or TIFF picture; its samples are not decoded.

    A damaged profile or EXIF block is left out and listed in `lost`. Raises MediaError for what is no picture.
    """
    path = Path(path)
    kind = sniff(path)
    if kind not in IMAGE_KINDS:
        raise MediaError(f"{path.name} is a clip, not a picture")
    try:
        return metadata_of(path.name, kind, path.read_bytes())
    except OSError as error:
        raise MediaError(f"{path.name} cannot be read: {error.strerror}") from error


def metadata_of(name: str, kind: str, data: bytes) -> PictureMetadata:
    """`read_picture_metadata` of a file's bytes, of the kind that `sniff` found."""
    readers: dict[str, Callable[[str, bytes], PictureMetadata]] = {
        "png": _of_png,
        "jpeg": _of_jpeg,
        "webp": _of_webp,
        "tiff": _of_tiff,
    }
    try:
        found = readers[kind](name, data)
    except TooManyPartsError as error:
        raise MediaError(f"{name} has more than {error}; save it again") from None
    except (struct.error, IndexError) as error:
        raise MediaError(f"{name} is damaged or cut short: the {kind} picture is not complete") from error
    if found.icc is not None and not _is_profile(found.icc):
        found = replace(found, icc=None, lost=(*found.lost, "a damaged colour profile"))
    return found


def _is_profile(icc: bytes) -> bool:
    """Whether the header fits (ICC.1, 7.2): signature "acsp", and the size of the file."""
    return 128 <= len(icc) <= _MOST_ICC_BYTES and icc[36:40] == b"acsp" and struct.unpack(">I", icc[:4])[0] <= len(icc)


def _with_exif(found: PictureMetadata, block: bytes | None, *, is_file: bool = False) -> PictureMetadata:
    if block is None:
        return found
    try:
        exif = read_exif(block, is_file=is_file)
    except ValueError:
        return replace(found, lost=(*found.lost, "a damaged EXIF block"))
    return replace(
        found, exif=exif.block(), orientation=exif.orientation, lost=tuple(dict.fromkeys((*exif.lost, *found.lost)))
    )


# --- PNG ------------------------------------------------------------------------------------------------------


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at, count = _PNG_SIGNATURE, 0
    while at + 12 <= len(data):
        count = _counted(count, "chunks")
        length, kind = struct.unpack_from(">I4s", data, at)
        yield kind, data[at + 8 : at + 8 + length] if kind != b"IDAT" else b""
        at += 12 + length


def _counted(parts: int, what: str) -> int:
    """One part more. Raises TooManyPartsError."""
    if parts == MOST_PARTS:
        raise TooManyPartsError(f"{MOST_PARTS} {what}")
    return parts + 1


def _png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _of_png(name: str, data: bytes) -> PictureMetadata:
    depth, color = data[24], data[25]
    icc, exif, has_alpha, lost = None, None, bool(color & 4), []
    shown: dict[bytes, bytes] = {}
    for kind, body in _png_chunks(data):
        has_alpha |= kind == b"tRNS"
        if kind == b"iCCP" and icc is None:
            icc = _inflated(body.partition(b"\0")[2][1:])
        elif kind == b"eXIf":
            exif = body
        elif kind in _PNG_COLOR and len(body) <= 64:
            shown.setdefault(kind, body)
        elif kind in _PNG_TEXT:
            lost.append("XMP" if body.startswith(b"XML:com.adobe.xmp") else "text")
        elif kind in (b"acTL", b"fcTL", b"fdAT"):
            lost.append("animation")
        elif kind not in _PNG_NEEDED:
            lost.append("a further chunk")
    found = PictureMetadata(
        icc=icc,
        depth=16 if depth == 16 else 8,
        has_alpha=has_alpha,
        png=tuple(shown.items()),
        lost=tuple(dict.fromkeys(lost)),
    )
    return _with_exif(found, exif)


def grey_key(data: bytes) -> int | None:
    """The one transparent code of a grey PNG (tRNS), on the scale of the 8 or 16 bits it is decoded to, or None."""
    bits, color = data[24], data[25]
    key = next((body for kind, body in _png_chunks(data) if kind == b"tRNS"), None) if color == 0 else None
    if key is None or len(key) < 2:
        return None
    top = (1 << bits) - 1
    code = int.from_bytes(key[:2], "big") & top
    return code * 255 // top if bits < 8 else code


def _inflated(body: bytes) -> bytes:
    stream = zlib.decompressobj()
    try:
        return stream.decompress(body, _MOST_ICC_BYTES)
    except zlib.error:
        return b""


def _into_png(data: bytes, metadata: PictureMetadata) -> bytes:
    chunks = b"".join(_png_chunk(kind, body) for kind, body in metadata.png)
    if metadata.icc is not None:
        chunks += _png_chunk(b"iCCP", b"ICC profile\0\0" + zlib.compress(metadata.icc, 9))
    if metadata.exif is not None:
        chunks += _png_chunk(b"eXIf", metadata.exif)
    end = _PNG_SIGNATURE + 25  # all of these stand before the first IDAT, some before PLTE: right after IHDR
    return data[:end] + chunks + data[end:]


# --- JPEG -----------------------------------------------------------------------------------------------------


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(marker, body) of the segments before the samples."""
    at, count = 2, 0
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        count = _counted(count, "segments")
        if marker in _STANDALONE:
            at += 2
            continue
        if marker in (0xDA, 0xD9):
            return
        (length,) = struct.unpack_from(">H", data, at + 2)
        yield marker, data[at + 4 : at + 2 + length]
        at += 2 + length


def _of_jpeg(name: str, data: bytes) -> PictureMetadata:
    parts: dict[int, bytes] = {}
    exif, density, lost = None, None, []
    for marker, body in _jpeg_segments(data):
        if marker == 0xE0 and body.startswith(_JFIF_SEGMENT) and body[_DENSITY] != _NO_DENSITY:
            density = body[_DENSITY]
        elif marker == 0xE2 and body.startswith(_ICC_SEGMENT):
            parts[body[len(_ICC_SEGMENT)]] = body[len(_ICC_SEGMENT) + 2 :]
        elif marker == 0xE1 and body.startswith(_EXIF_SEGMENT):
            exif = body if exif is None else exif
        elif marker == 0xE1 and body.startswith(_XMP_SEGMENTS):
            lost.append("XMP")
        elif marker == 0xE2 and body.startswith(b"MPF\0"):
            lost.append("further pictures (such as a gain map)")
        elif marker == 0xED:
            lost.append("IPTC")
        elif marker == 0xFE:
            lost.append("text")
        elif marker in JPEG_FRAMES and len(body) > 5 and body[5] == _INKS:
            lost.append("coding in four inks (CMYK)")
        elif 0xE0 < marker <= 0xEF and marker != 0xEE:
            lost.append(f"the segment APP{marker - 0xE0}")
    icc = b"".join(parts[k] for k in sorted(parts)) if parts else None
    return _with_exif(PictureMetadata(icc=icc, density=density, lost=tuple(dict.fromkeys(lost))), exif)


def _into_jpeg(data: bytes, metadata: PictureMetadata) -> bytes:
    segments = b""
    if metadata.exif is not None and len(metadata.exif) <= _MOST_JPEG_EXIF_BYTES:
        segments += _jpeg_segment(0xE1, _EXIF_SEGMENT + metadata.exif)
    if metadata.icc is not None:
        room = 65535 - 2 - len(_ICC_SEGMENT) - 2
        pieces = [metadata.icc[k : k + room] for k in range(0, len(metadata.icc), room)]
        if len(pieces) <= 255:
            for number, piece in enumerate(pieces, 1):
                segments += _jpeg_segment(0xE2, _ICC_SEGMENT + bytes([number, len(pieces)]) + piece)
    if data[2:4] != b"\xff\xe0":
        return data[:2] + segments + data[2:]
    # JFIF asks to be the first segment
    at = 4 + struct.unpack_from(">H", data, 4)[0]
    first = bytearray(data[6:at])
    first[_DENSITY] = metadata.density or first[_DENSITY]
    return data[:6] + bytes(first) + segments + data[at:]


def _jpeg_segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


# --- WebP -----------------------------------------------------------------------------------------------------

_WEBP_ICC, _WEBP_ALPHA, _WEBP_EXIF = 0x20, 0x10, 0x08


def _webp_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at, count = 12, 0
    while at + 8 <= len(data):
        count = _counted(count, "chunks")
        kind, length = struct.unpack_from("<4sI", data, at)
        yield kind, data[at + 8 : at + 8 + length]
        at += 8 + length + length % 2


def _of_webp(name: str, data: bytes) -> PictureMetadata:
    chunks = dict(reversed(list(_webp_chunks(data))))
    has_alpha = b"ALPH" in chunks
    if b"VP8L" in chunks:  # bit 28 after the signature and the two sizes: alpha_is_used
        has_alpha = bool(struct.unpack_from("<I", chunks[b"VP8L"], 1)[0] >> 28 & 1)
    known = {b"VP8X", b"VP8 ", b"VP8L", b"ALPH", b"ICCP", b"EXIF"}
    lost = ["XMP" if kind == b"XMP " else "a further chunk" for kind in chunks if kind not in known]
    return _with_exif(
        PictureMetadata(icc=chunks.get(b"ICCP"), has_alpha=has_alpha, lost=tuple(dict.fromkeys(lost))),
        chunks.get(b"EXIF"),
    )


def _into_webp(data: bytes, metadata: PictureMetadata, size: tuple[int, int]) -> bytes:
    chunks = list(_webp_chunks(data))
    flags = dict(chunks).get(b"VP8X", b"\0")[0]
    if b"VP8L" in dict(chunks) and struct.unpack_from("<I", dict(chunks)[b"VP8L"], 1)[0] >> 28 & 1:
        flags |= _WEBP_ALPHA
    picture = [(kind, body) for kind, body in chunks if kind in (b"ALPH", b"VP8 ", b"VP8L")]
    if metadata.icc is not None:
        picture.insert(0, (b"ICCP", metadata.icc))
        flags |= _WEBP_ICC
    if metadata.exif is not None:
        picture.append((b"EXIF", metadata.exif))
        flags |= _WEBP_EXIF
    canvas = b"".join((side - 1).to_bytes(3, "little") for side in size)
    picture.insert(0, (b"VP8X", bytes([flags, 0, 0, 0]) + canvas))
    body = b"".join(kind + struct.pack("<I", len(item)) + item + b"\0" * (len(item) % 2) for kind, item in picture)
    return b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body


# --- TIFF -----------------------------------------------------------------------------------------------------


def _of_tiff(name: str, data: bytes) -> PictureMetadata:
    header = tiff_header(name, data)
    directory, following = Block(data).directory(Block(data).first)
    icc = directory[ICC_TAG].body if ICC_TAG in directory else None
    lost = ["thumbnail"] if following else []
    if header.alpha == "premultiplied":
        lost.append("premultiplied alpha (colours are divided by it)")
    found = PictureMetadata(icc=icc, depth=header.depth, has_alpha=header.alpha != "none", lost=tuple(lost))
    return _with_exif(found, data, is_file=True)


# --- what is kept ---------------------------------------------------------------------------------------------


def embedded(suffix: str, data: bytes, metadata: PictureMetadata, size: tuple[int, int]) -> bytes:
    """An encoded PNG, JPEG or WebP file with profile and EXIF put in; size: its (width, height).

    A profile that is not for RGB, the colours that pictures are written in, is left out, as is what the container
    has no room for; see `lost_in_picture`.
    """
    metadata = replace(metadata, icc=rgb_profile(metadata.icc))
    if metadata.icc is None and metadata.exif is None and not metadata.png and metadata.density is None:
        return data
    if suffix == ".png":
        return _into_png(data, metadata)
    if suffix in (".jpg", ".jpeg"):
        return _into_jpeg(data, metadata)
    return data if metadata.icc is None and metadata.exif is None else _into_webp(data, metadata, size)


def rgb_profile(icc: bytes | None) -> bytes | None:
    """The profile, if its colours are RGB (ICC.1, 7.2.6), else None."""
    return icc if icc is not None and icc[16:20] == b"RGB " else None


def lost_in_picture(source: str | Path, target: str | Path) -> tuple[str, ...]:
    """What a picture loses when it is drawn and written as `target`, a line each; nothing is decoded.

    source: a JPEG, PNG, WebP or TIFF file. target: a name whose suffix is one of `IMAGE_SUFFIXES`; it need not exist.
    Raises MediaError for a source that is no picture.
    """
    found, suffix = read_picture_metadata(source), Path(target).suffix.lower()
    lines = []
    if found.depth > 8 and suffix not in _DEEP_SUFFIXES:
        lines.append(f"{suffix} holds 8 bits a sample: the picture's 16 are reduced; write .png or .tiff to keep them")
    if found.has_alpha and suffix not in _ALPHA_SUFFIXES:
        lines.append(f"{suffix} holds no transparency: the picture's alpha is not kept; write .png, .webp or .tiff")
    if found.icc is not None and rgb_profile(found.icc) is None:
        lines.append("the picture's colour profile is not for RGB and is not kept")
    if suffix in (".jpg", ".jpeg") and found.exif is not None and len(found.exif) > _MOST_JPEG_EXIF_BYTES:
        lines.append("the picture's EXIF is too long for JPEG and is not kept")
    if found.png and suffix != ".png":
        kinds = ", ".join(kind.decode("latin-1") for kind, _ in found.png)
        lines.append(f"the picture's PNG chunks {kinds} are not kept; write .png to keep them")
    if found.density is not None and suffix not in (".jpg", ".jpeg"):
        lines.append("the picture's resolution is not kept; write .jpg to keep it")
    lines += [f"the picture's {what} is not kept" for what in found.lost]
    return tuple(lines)
