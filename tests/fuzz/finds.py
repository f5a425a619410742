"""What fuzzing found, cut down to the bytes that matter; a case for each."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pvg.asset.arrays import from_bytes
from pvg.errors import MediaError
from pvg.video import probe
from tests.gallery.hostile import box

_NPY = b"\x93NUMPY\x01\x00"


@dataclass(frozen=True)
class Find:
    """what: went wrong, with `do` and these bytes; expected: the answer since."""

    what: str
    do: Callable[[bytes], object]
    data: bytes
    expected: type[Exception]


def _probed(data: bytes) -> object:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.mp4"
        path.write_bytes(data)
        return probe(path)


_FTYP = box(b"ftyp", b"isom" + bytes(4))
_PICTURES = box(b"hdlr", bytes(8) + b"vide")
#: a box that claims 1000 bytes at the end of a file that has none of them
_BEYOND = struct.Struct(">I4s")

FINDS = (
    Find(
        "TokenError for an array whose header ends early",
        from_bytes,
        b'{"dtype": "|u1", "shape": [1]}\n' + _NPY + b"\x10\x00{'descr': (\n    ",
        ValueError,
    ),
    Find(
        "struct.error for an MP4 whose references of data end behind the file",
        _probed,
        _FTYP + box(b"moov", _BEYOND.pack(1000, b"dref") + bytes(8)),
        MediaError,
    ),
    Find(
        "struct.error for an MP4 whose description of samples ends behind the file",
        _probed,
        _FTYP + box(b"moov", _PICTURES + _BEYOND.pack(1000, b"stsd")),
        MediaError,
    ),
)
