"""The media types that the service takes in and gives out, and the suffix that their files carry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class FileType:
    """An allowed media type and the suffix its blobs carry."""

    content_type: str
    suffix: str


MP4: Final = FileType("video/mp4", ".mp4")
MOV: Final = FileType("video/quicktime", ".mov")
WEBM: Final = FileType("video/webm", ".webm")
MKV: Final = FileType("video/x-matroska", ".mkv")
AVI: Final = FileType("video/x-msvideo", ".avi")
JPEG: Final = FileType("image/jpeg", ".jpg")
PNG: Final = FileType("image/png", ".png")
WEBP: Final = FileType("image/webp", ".webp")
TIFF: Final = FileType("image/tiff", ".tiff")
CUBE: Final = FileType("text/plain", ".cube")

_ALL: Final = (MP4, MOV, WEBM, MKV, AVI, JPEG, PNG, WEBP, TIFF, CUBE)
_BY_SUFFIX: Final = {kind.suffix: kind.content_type for kind in _ALL}


def content_type_of(suffix: str) -> str:
    """The media type of a file with this suffix, such as ``.mp4``. Raises `KeyError` for any other."""
    return _BY_SUFFIX[suffix.lower()]
