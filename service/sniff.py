"""What a file is, by its first bytes. The door only: the vectoriser checks the whole file later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

#: bytes of the file's head that `sniff` wants to see
HEAD_BYTES: Final = 4096


@dataclass(frozen=True)
class FileType:
    """An allowed media type and the suffix its blobs carry."""

    content_type: str
    suffix: str

    @property
    def is_image(self) -> bool:
        """True for a still picture."""
        return self.content_type.startswith("image/")


MP4: Final = FileType("video/mp4", ".mp4")
MOV: Final = FileType("video/quicktime", ".mov")
WEBM: Final = FileType("video/webm", ".webm")
MKV: Final = FileType("video/x-matroska", ".mkv")
AVI: Final = FileType("video/x-msvideo", ".avi")
JPEG: Final = FileType("image/jpeg", ".jpg")
PNG: Final = FileType("image/png", ".png")
WEBP: Final = FileType("image/webp", ".webp")

_BY_SUFFIX: Final = {kind.suffix: kind.content_type for kind in (MP4, MOV, WEBM, MKV, AVI, JPEG, PNG, WEBP)}
_MAGIC: Final = {b"\xff\xd8\xff": JPEG, b"\x89PNG\r\n\x1a\n": PNG}
# pictures in the same box format as mp4, which the method does not read
_OTHER_BRANDS: Final = {b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif", b"avis", b"crx "}
# boxes that open a QuickTime file written without `ftyp`
_OLD_QUICKTIME: Final = {b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot"}


def content_type_of(suffix: str) -> str:
    """The media type of a result's suffix, such as ``.mp4``."""
    return _BY_SUFFIX[suffix.lower()]


def sniff(head: bytes) -> FileType | None:
    """The media type of a file that begins with ``head``, or None when it is not an allowed one."""
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    if head.startswith(b"RIFF"):
        return {b"WEBP": WEBP, b"AVI ": AVI}.get(head[8:12])
    if head.startswith(b"\x1a\x45\xdf\xa3"):
        # the DocType element sits in the EBML header, well inside the first kilobyte
        return WEBM if b"webm" in head[:64] else MKV if b"matroska" in head[:64] else None
    box = head[4:8]
    if box == b"ftyp":
        brand = head[8:12]
        if brand in _OTHER_BRANDS:
            return None
        return MOV if brand == b"qt  " else MP4
    return MOV if box in _OLD_QUICKTIME else None
