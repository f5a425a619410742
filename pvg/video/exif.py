"""EXIF blocks (CIPA DC-008): what of one is kept with a picture that was drawn anew."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from pvg.video.ifd import HEADER, Block, Directory, numbers_of, shorts, written

ORIENTATION = 0x0112
_EXIF, _GPS, _INTEROPERABILITY, _MAKER_NOTE, _XMP, _ICC = 0x8769, 0x8825, 0xA005, 0x927C, 0x02BC, 0x8773
_LEFT_OUT = {"XMP": (_XMP,), "IPTC": (0x83BB,), "Photoshop's layers and resources": (0x8649, 0x935C)}
"""Whole records of other programs by what they hold: the picture as it was, places, and EXIF once more."""
_SIZES = (0xA002, 0xA003)  # PixelXDimension, PixelYDimension
_DESCRIBES_SAMPLES = {
    *(0x00FE, 0x00FF, 0x0100, 0x0101, 0x0102, 0x0103, 0x0106, 0x010A, 0x0111, 0x0115, 0x0116, 0x0117, 0x0118, 0x0119),
    *(0x011C, 0x0120, 0x0121, 0x0122, 0x0123, 0x012D, 0x013D, 0x0140, 0x0141, 0x0142, 0x0143, 0x0144, 0x0145, 0x014A),
    *(0x0152, 0x0153, 0x0154, 0x0155, 0x015B, 0x0200, 0x0201, 0x0202, 0x0211, 0x0212, 0x0213, 0x0214),
}
"""Tags of TIFF 6.0 that say how samples are stored: what a picture written anew says for itself."""


@dataclass(frozen=True)
class Exif:
    """What an EXIF block says that outlives drawing.

    main: the tags of its first directory that describe the picture, without those of how samples are stored.
    details: those of its EXIF directory. orientation: 1 to 8 as stored (TIFF 6.0, tag 274), to be applied once.
    lost: what the block held and these do not: "location", "thumbnail", "maker's note", "XMP", "IPTC", …
    """

    main: Directory
    details: Directory
    orientation: int = 1
    lost: tuple[str, ...] = ()

    def block(self) -> bytes | None:
        """A block of these tags, without the prefix "Exif\\0\\0"; None when there are none."""
        if not self.main and not self.details:
            return None
        children = {_EXIF: self.details} if self.details else {}
        return HEADER + struct.pack("<I", 8) + written(self.main, children, 8)


def read_exif(data: bytes, *, is_file: bool = False) -> Exif:
    """The parts of an EXIF block that are kept: all but location, thumbnail, maker's note and other programs' records.

    data: the block, with or without its prefix "Exif\\0\\0", or a TIFF file, whose tags are the same (is_file). The
    orientation becomes 1, for pictures are drawn upright, and width and height are exchanged where it was sideways.
    The maker's note is left out, for its layout is the maker's own, and it may tell a place or hold a preview.
    Raises ValueError for a damaged block.
    """
    block = Block(data if is_file else data.removeprefix(b"Exif\0\0"))
    main, following = block.directory(block.first)
    details: Directory = {}
    pointer = numbers_of(main, _EXIF)
    if pointer:
        details, _ = block.directory(pointer[0])
    orientation = numbers_of(main, ORIENTATION, (1,))[0]
    orientation = orientation if 1 <= orientation <= 8 else 1
    if orientation >= 5 and all(tag in details for tag in _SIZES):
        details[_SIZES[0]], details[_SIZES[1]] = details[_SIZES[1]], details[_SIZES[0]]
    held = {
        "location": _GPS in main,
        "thumbnail": bool(following) and not is_file,
        "maker's note": _MAKER_NOTE in details,
    } | {what: any(tag in main for tag in tags) for what, tags in _LEFT_OUT.items()}
    if ORIENTATION in main:
        main[ORIENTATION] = shorts(1)
    left_out = _DESCRIBES_SAMPLES.union({_EXIF, _GPS, _ICC}, *_LEFT_OUT.values())
    main = {tag: entry for tag, entry in main.items() if tag not in left_out}
    details = {tag: entry for tag, entry in details.items() if tag not in (_MAKER_NOTE, _INTEROPERABILITY)}
    if is_file and set(main) <= {ORIENTATION} and not details:
        main = {}
    return Exif(main, details, orientation, tuple(what for what, there in held.items() if there))


def placed_in(directory: Directory, exif: bytes | None) -> tuple[Directory, dict[int, Directory]]:
    """A TIFF file's directory with the tags of an EXIF block, and its children; see `pvg.video.ifd.written`."""
    if exif is None:
        return directory, {}
    kept = read_exif(exif)
    return kept.main | directory, {_EXIF: kept.details} if kept.details else {}
