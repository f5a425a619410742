"""Files on this side: their hashes, and downloads that grow until they are whole."""

from __future__ import annotations

import base64
import hashlib
import os
import re
import secrets
from collections.abc import Iterator
from itertools import chain, count, takewhile
from pathlib import Path
from typing import IO, Final
from urllib.parse import quote

import httpx

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

#: bytes of a name that file systems take
_NAME_BYTES: Final = 255
#: of a name that goes into another one
_PART_BYTES: Final = 200
_SUFFIX_BYTES: Final = 15
_RANGE_BEGIN: Final = re.compile(r"bytes (\d+)-")


def sha256_of(path: Path) -> str:
    """The hash of a file, as hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def in_base64(sha256: str) -> str:
    """A hash as headers have it (RFC 9530; tus)."""
    return base64.b64encode(bytes.fromhex(sha256)).decode()


def about_file(path: Path, size_bytes: int, sha256: str) -> dict[str, str]:
    """What is said of a file that is the body of a request: its size, its name (RFC 6266) and its hash (RFC 9530)."""
    return {
        "Content-Type": "application/octet-stream",
        "Content-Length": str(size_bytes),
        "Content-Disposition": f"attachment; filename*=UTF-8''{quote(path.name, safe='', errors='replace')}",
        "Repr-Digest": f"sha-256=:{in_base64(sha256)}:",
    }


def local_name(name: str) -> str:
    """A name from elsewhere as one of a file here: no longer than that may be, and without the colon of a drive."""
    name = name.replace(":", "_")
    if len(name.encode(errors="replace")) <= _NAME_BYTES:
        return name
    stem, suffix = _split(name)
    return _begun(stem, _NAME_BYTES - _SUFFIX_BYTES) + suffix


def _numbered(name: str, number: int) -> str:
    """The name of a further file of this name, as browsers have it: ``look (2).mp4``. No longer than that may be."""
    stem, suffix = _split(name)
    tail = f" ({number}){suffix}"
    return _begun(stem, _NAME_BYTES - len(tail.encode(errors="replace"))) + tail


def _split(name: str) -> tuple[str, str]:
    """What comes before the suffix of a name, and the suffix, if it can be one."""
    stem, suffix = os.path.splitext(name)
    return (stem, suffix) if len(suffix.encode(errors="replace")) <= _SUFFIX_BYTES else (name, "")


def _begun(text: str, most_bytes: int) -> str:
    """As many whole characters of a text as have room."""
    return text.encode(errors="replace")[:most_bytes].decode(errors="ignore")


def there_already(target: Path, sha256: str) -> Path | None:
    """The file with these bytes that is called as ``target``, or that with a number; None when there is none."""
    taken = takewhile(os.path.lexists, _names_from(target))
    return next((path for path in taken if _has(path, sha256)), None)


def _names_from(target: Path) -> Iterator[Path]:
    return chain((target,), (target.with_name(_numbered(target.name, number)) for number in count(2)))


def _has(path: Path, sha256: str) -> bool:
    return path.is_file() and sha256_of(path) == sha256


def _placed(path: Path, target: Path) -> bool:
    """Give a file another name if that is free, and whether it was: nobody else's file is replaced."""
    try:
        os.link(path, target)
    except FileExistsError:
        return False
    except FileNotFoundError:
        raise
    except OSError:  # a file system without links: an empty file keeps the name meanwhile
        try:
            target.touch(exist_ok=False)
        except FileExistsError:
            return False
        try:
            path.replace(target)
        except OSError:
            target.unlink()
            raise
        return True
    path.unlink()
    return True


class PartFile:
    """A download to ``target`` that is not whole yet, beside it under a hidden name. One at a time has the use of it.

    What is there stays for the next attempt, and for the next run. A second download to the same place, in this process
    or another, has a file of its own meanwhile, which it takes away when it ends; when its process is killed, that file
    is left behind.
    """

    def __init__(self, target: Path, sha256: str) -> None:
        self._sha256 = sha256
        name = _begun(target.name, _PART_BYTES)
        self.path = target.with_name(f".{name}.{sha256[:16]}.part")
        self._file = _held(self.path)
        self._is_shared = self._file is not None
        if self._file is None:
            self.path = target.with_name(f".{name}.{sha256[:16]}.{secrets.token_hex(4)}.part")
            self._file = self.path.open("ab")

    @property
    def size(self) -> int:
        """Bytes that are there."""
        assert self._file is not None  # noqa: S101
        # of the file, not of its name: that may have been removed
        return os.fstat(self._file.fileno()).st_size

    def begin(self, response: httpx.Response) -> None:
        """Keep what is there when the answer goes on after it, else begin anew."""
        found = _RANGE_BEGIN.match(response.headers.get("content-range", ""))
        goes_on = response.status_code == httpx.codes.PARTIAL_CONTENT and found and int(found[1]) == self.size
        if not goes_on:
            self.clear()

    def write(self, data: bytes) -> None:
        """Append a piece."""
        assert self._file is not None  # noqa: S101 - open until it is put in place or closed
        self._file.write(data)
        self._file.flush()

    def clear(self) -> None:
        """Forget what is there."""
        assert self._file is not None  # noqa: S101
        self._file.truncate(0)

    def put(self, target: Path) -> None:
        """Let it take its place, whole."""
        if fcntl is None:
            self._let_go()  # what is open cannot be renamed everywhere
        self.path.replace(target)
        self._let_go()

    def put_beside(self, target: Path) -> Path:
        """Let it take its place, whole, or where another file has that name, one with a number; where it is then.

        No file is replaced, also when several come at once. Of one with the same bytes there is no second.
        """
        if fcntl is None:
            self._let_go()
        names = _names_from(target)
        found = next(name for name in names if _placed(self.path, name) or _has(name, self._sha256))
        self.path.unlink(missing_ok=True)
        self._let_go()
        return found

    def close(self) -> None:
        """Let others have it. What only this download has had goes, and what is empty."""
        if self._file is None:
            return
        is_left = self._is_shared and self.size > 0
        if fcntl is None:
            self._let_go()
        if not is_left:
            self.path.unlink(missing_ok=True)
        self._let_go()

    def _let_go(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def _held(path: Path) -> IO[bytes] | None:
    """The file at a path, for this download alone; None while another has it. Where there are no locks, it is had."""
    while True:
        file = path.open("ab")
        if fcntl is None:
            return file
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        except BlockingIOError:
            file.close()
            return None
        except FileNotFoundError:
            pass  # the one who had it may have put it in its place meanwhile
        except OSError:
            return file  # a file system without locks
        file.close()
