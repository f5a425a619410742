"""What a still picture carries beside its samples, as one value; and the limit of a picture's parts."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pvg.video.exif import read_exif

MOST_PARTS = 100_000
"""Chunks or segments of a picture; an encoder makes some hundreds at most."""
MOST_ICC_BYTES = 16 * 2**20


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


def counted(parts: int, what: str) -> int:
    """One part more. Raises TooManyPartsError."""
    if parts == MOST_PARTS:
        raise TooManyPartsError(f"{MOST_PARTS} {what}")
    return parts + 1


def with_exif(found: PictureMetadata, block: bytes | None, *, is_file: bool = False) -> PictureMetadata:
    """What was found, with what an EXIF block says; a damaged one is listed in `lost`.

    is_file: whether the block is a whole TIFF file.
    """
    if block is None:
        return found
    try:
        exif = read_exif(block, is_file=is_file)
    except ValueError:
        return replace(found, lost=(*found.lost, "a damaged EXIF block"))
    return replace(
        found, exif=exif.block(), orientation=exif.orientation, lost=tuple(dict.fromkeys((*exif.lost, *found.lost)))
    )
