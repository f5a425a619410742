"""Colour profile and EXIF of a still picture, found in a file and put into another; what a new file loses.

The kinds of files are `png`, `jpeg`, `webp` and `tiff`; of the last the profile is tag 34675 of ICC.1 annex B.4.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pvg.errors import MediaError
from pvg.video.ifd import Block
from pvg.video.jpeg import MOST_EXIF_BYTES, into_jpeg, jpeg_metadata
from pvg.video.metadata_record import MOST_ICC_BYTES, PictureMetadata, TooManyPartsError, with_exif
from pvg.video.png import into_png, png_metadata
from pvg.video.sniffing import IMAGE_KINDS, sniff
from pvg.video.tiff import ICC_TAG, tiff_header
from pvg.video.webp import into_webp, webp_metadata

_ALPHA_SUFFIXES = (".png", ".webp", ".tif", ".tiff")
_DEEP_SUFFIXES = (".png", ".tif", ".tiff")


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
    readers: dict[str, Callable[[bytes], PictureMetadata]] = {
        "png": png_metadata,
        "jpeg": jpeg_metadata,
        "webp": webp_metadata,
    }
    try:
        found = _tiff_metadata(name, data) if kind == "tiff" else readers[kind](data)
    except TooManyPartsError as error:
        raise MediaError(f"{name} has more than {error}; save it again") from None
    except (struct.error, IndexError) as error:
        raise MediaError(f"{name} is damaged or cut short: the {kind} picture is not complete") from error
    if found.icc is not None and not _is_profile(found.icc):
        found = replace(found, icc=None, lost=(*found.lost, "a damaged colour profile"))
    return found


def _is_profile(icc: bytes) -> bool:
    """Whether the header fits (ICC.1, 7.2): signature "acsp", and the size of the file."""
    return 128 <= len(icc) <= MOST_ICC_BYTES and icc[36:40] == b"acsp" and struct.unpack(">I", icc[:4])[0] <= len(icc)


def _tiff_metadata(name: str, data: bytes) -> PictureMetadata:
    header = tiff_header(name, data)
    directory, following = Block(data).directory(Block(data).first)
    icc = directory[ICC_TAG].body if ICC_TAG in directory else None
    lost = ["thumbnail"] if following else []
    if header.alpha == "premultiplied":
        lost.append("premultiplied alpha (colours are divided by it)")
    found = PictureMetadata(icc=icc, depth=header.depth, has_alpha=header.alpha != "none", lost=tuple(lost))
    return with_exif(found, data, is_file=True)


def embedded(suffix: str, data: bytes, metadata: PictureMetadata, size: tuple[int, int]) -> bytes:
    """An encoded PNG, JPEG or WebP file with profile and EXIF put in; size: its (width, height).

    A profile that is not for RGB, the colours that pictures are written in, is left out, as is what the container
    has no room for; see `lost_in_picture`.
    """
    metadata = replace(metadata, icc=rgb_profile(metadata.icc))
    if metadata.icc is None and metadata.exif is None and not metadata.png and metadata.density is None:
        return data
    if suffix == ".png":
        return into_png(data, metadata)
    if suffix in (".jpg", ".jpeg"):
        return into_jpeg(data, metadata)
    return data if metadata.icc is None and metadata.exif is None else into_webp(data, metadata, size)


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
    if suffix in (".jpg", ".jpeg") and found.exif is not None and len(found.exif) > MOST_EXIF_BYTES:
        lines.append("the picture's EXIF is too long for JPEG and is not kept")
    if found.png and suffix != ".png":
        kinds = ", ".join(kind.decode("latin-1") for kind, _ in found.png)
        lines.append(f"the picture's PNG chunks {kinds} are not kept; write .png to keep them")
    if found.density is not None and suffix not in (".jpg", ".jpeg"):
        lines.append("the picture's resolution is not kept; write .jpg to keep it")
    lines += [f"the picture's {what} is not kept" for what in found.lost]
    return tuple(lines)
