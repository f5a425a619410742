"""What a file is, by its first bytes. A first check only: the vectoriser checks the whole file later."""

from __future__ import annotations

from typing import Final

from service.catalog import AVI, JPEG, MKV, MOV, MP4, PNG, TIFF, WEBM, WEBP, FileType

#: bytes of the file's head that `sniff` wants to see
HEAD_BYTES: Final = 4096


_MAGIC: Final = {b"\xff\xd8\xff": JPEG, b"\x89PNG\r\n\x1a\n": PNG, b"II*\0": TIFF, b"MM\0*": TIFF}
# pictures in the same box format as mp4, which the method does not read
_OTHER_BRANDS: Final = {b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif", b"avis", b"crx "}
# boxes that open a QuickTime file written without `ftyp`; fragments (`moof`) before their index open in no reader
_OLD_QUICKTIME: Final = {b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot"}


#: what is allowed, as people call it
FORMATS: Final = ("mp4", "mov", "webm", "mkv", "avi", "jpeg", "png", "webp", "tiff")


def sniff(head: bytes) -> FileType | None:
    """The media type of a file that begins with ``head``, or None when it is not an allowed one."""
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    if head.startswith(b"RIFF"):
        return _riff(head)
    if head.startswith(b"\x1a\x45\xdf\xa3"):
        # the DocType element sits in the EBML header, well inside the first kilobyte
        return WEBM if b"webm" in head[:64] else MKV if b"matroska" in head[:64] else None
    return _iso_media(head)


def _riff(head: bytes) -> FileType | None:
    # bit 1 of the VP8X flags: animation
    if head[8:16] == b"WEBPVP8X" and len(head) > 20 and head[20] & 0b10:
        return None
    return {b"WEBP": WEBP, b"AVI ": AVI}.get(head[8:12])


def _iso_media(head: bytes) -> FileType | None:
    box, brand = head[4:8], head[8:12]
    if box == b"ftyp":
        return None if brand in _OTHER_BRANDS else MOV if brand == b"qt  " else MP4
    if box == b"styp":  # a segment of a stream, saved together with its index
        return MP4
    return MOV if box in _OLD_QUICKTIME else None
