"""The entries of an asset file, read so that none costs more than it may: assets may be made by others.

A file of some kilobytes can say that it holds gigabytes, and inflate to them. Every size is therefore known, and
bounded, before memory is taken for it, and what inflates stops there.
"""

from __future__ import annotations

import bz2
import copy
import errno
import io
import lzma
import os
import shutil
import struct
import zipfile
import zlib
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, Final

#: what zipfile and its decompressors raise on damaged bytes
DAMAGE: Final = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    KeyError,
    IndexError,
    ValueError,
    RuntimeError,
    OverflowError,
    OSError,
    EOFError,
)
#: bytes of the directory at the end of the file: 480,000 entries, of an hour of clip with 16 faces
_MAX_DIRECTORY_BYTES: Final = 32 * 1024**2
#: bytes of the manifest, beside those for each entry
_MANIFEST_BYTES, _MANIFEST_BYTES_PER_ENTRY = 1024**2, 256
_COPIED_BYTES: Final = 1024**2  # at once


class _File(io.FileIO):
    """A file that is never read whole by mistake: zipfile reads as much at once as the file itself says.

    It has a place of its own: that of the system is shared with forked processes, which read at the same time.
    """

    _at = 0

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        if start + offset < 0:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        self._at = start + offset
        return self._at

    def again(self) -> _File:
        """The same file, opened once more, from its beginning."""
        return _File(os.dup(self.fileno()))

    @property
    def _size(self) -> int:
        return os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or size < 0:
            size = max(0, self._size - self._at)
        if size > _MAX_DIRECTORY_BYTES:
            raise zipfile.BadZipFile("its directory is too large")
        data = os.pread(self.fileno(), size, self._at)
        self._at += len(data)
        return data


class Entries:
    """The entries of one file, open for reading. Raises one of `DAMAGE` when it is none, `FileNotFoundError` too."""

    def __init__(self, path: Path) -> None:
        self._file = _File(path)
        try:
            self._zip = zipfile.ZipFile(self._file)
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file. Twice is harmless."""
        self._zip.close()
        self._file.close()

    @property
    def closed(self) -> bool:
        """Whether it was closed: nothing is read any more."""
        return self._file.closed

    @property
    def comment(self) -> bytes:
        """What stands at the end of the file."""
        return self._zip.comment

    @property
    def manifest_limit(self) -> int:
        """The most bytes that the manifest of a file with so many entries has."""
        return _MANIFEST_BYTES + _MANIFEST_BYTES_PER_ENTRY * len(self._zip.filelist)

    def copy_to(self, out: BinaryIO) -> None:
        """Write all of the file as it was opened, though another one may have its name by now."""
        with closing(self._file.again()) as data:
            shutil.copyfileobj(data, out, _COPIED_BYTES)

    def read(self, name: str, limit: int) -> bytes:
        """The bytes of an entry, at most `limit`. Raises one of `DAMAGE`."""
        info = self._zip.getinfo(name)
        if info.file_size > limit:
            raise ValueError(f"it would have {info.file_size} bytes, more than {limit}")
        if info.compress_size > limit + limit // 64 + 1024:
            raise ValueError("it is larger than what it holds")
        with self._zip.open(_as_stored(info)) as entry:
            packed = entry.read()
        data = _inflate(packed, info.compress_type, info.file_size)
        if len(data) != info.file_size:
            raise ValueError("it has another size than it says")
        return data


def _as_stored(info: zipfile.ZipInfo) -> zipfile.ZipInfo:
    """The entry's packed bytes as an entry: zipfile's own inflating of bzip2 has no end."""
    packed = copy.copy(info)
    packed.compress_type, packed.file_size = zipfile.ZIP_STORED, info.compress_size
    del packed.CRC  # of what is inflated; the manifest has a better digest
    return packed


def _inflate(packed: bytes, method: int, size: int) -> bytes:
    """At most `size` + 1 bytes of what was packed by one of the two methods that assets are written with."""
    if method == zipfile.ZIP_STORED:
        return packed
    if method == zipfile.ZIP_DEFLATED:
        return zlib.decompressobj(-zlib.MAX_WBITS).decompress(packed, size + 1)
    if method == zipfile.ZIP_BZIP2:
        return bz2.BZ2Decompressor().decompress(packed, size + 1)
    raise ValueError("it is packed in a way that assets are not")
