"""Blobs: immutable files named by the hash of their content, in a local folder or an object store.

A key holds the content's sha256 and the id of the record that owns the blob. Two records never share a blob, so
deleting one needs no counting of users and cannot race with another upload of the same bytes.
"""

from __future__ import annotations

import asyncio
import errno
import os
import re
import secrets
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, cast, get_args

import obstore
from obstore.exceptions import GenericError
from obstore.store import LocalStore, ObjectStore, from_url

from service import copying
from service.settings import Settings, store_secrets
from service.spool import Spool

if TYPE_CHECKING:
    from obstore import SignCapableStore
    from obstore.store import ClientConfig, RetryConfig, S3Config

Kind = Literal["source", "asset", "pictures", "result", "preview", "part", "drawn"]

CHUNK_BYTES = 256 * 1024
#: what the store has beside the blobs begins with this
_OUR_OWN: Final = "."
#: in a local folder, what is being written: on the disk of the blobs, where the spool may not be
_INCOMING: Final = ".incoming"
_MARK: Final = ".database"
#: what the disk of a local folder says that is gone, or whose server is
_AWAY: Final = frozenset({errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EHOSTDOWN, errno.ENOTCONN})
_KEY: Final = re.compile(
    rf"({'|'.join(get_args(Kind))})/([0-9a-f]{{2}})/\2[0-9a-f]{{62}}-[a-z]{{3}}_[0-9a-f]{{32}}[-.\w]*", re.ASCII
)
_PROBE: Final = re.compile(r"probe/[0-9a-f]{16}")
_RETRIES: Final[RetryConfig] = {"max_retries": 3, "retry_timeout": timedelta(seconds=5)}
#: how long a whole transfer may take, its slow reader included (obstore's own limit is 30 s), and how long nothing may
#: come. Sending is one wait: each part of a file has to be taken within the latter
_PATIENCE: Final[ClientConfig] = {"timeout": "1day", "read_timeout": "30s"}
#: what else obstore's client reads from `AWS_…`, and only where it is given no options
_OF_CLIENT: Final = (
    *("allow_http", "allow_invalid_certificates", "connect_timeout", "default_content_type", "http1_only"),
    *("http2_keep_alive_interval", "http2_keep_alive_timeout", "http2_keep_alive_while_idle", "http2_only"),
    *("pool_idle_timeout", "pool_max_idle_per_host", "proxy_ca_certificate", "proxy_excludes", "proxy_url"),
    *("randomize_addresses", "read_timeout", "timeout", "user_agent"),
)


class BlobMissingError(Exception):
    """The storage has no blob of this key."""


class NotMountedError(GenericError):
    """Where the blobs were is another folder: an empty mount point, most likely."""


class Storage:
    """The blobs of one service, and the ``spool`` in which those that are made here are written.

    A local folder that carried a mark, as was seen before or as ``was_marked`` says, and has none, is a disk that is
    not mounted: its blobs are not missing, and nothing is written there. Calls raise `NotMountedError`, an outage.
    """

    def __init__(self, settings: Settings, *, was_marked: Callable[[], bool] = lambda: False) -> None:
        self._was_marked = was_marked
        self._has_mark = False
        self._folder = settings.local_storage_folder
        self.spool = Spool(settings.spool_folder)
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._store: ObjectStore = LocalStore(self._folder)
        else:
            # who waits for longer does so knowingly: obstore's own three minutes hold up requests and leases
            is_s3 = settings.storage_url.startswith("s3")
            config = store_secrets(os.environ) if is_s3 else {}
            self._store = from_url(
                settings.storage_url,
                config=cast("S3Config", config) or None,
                client_options=client_options(os.environ) if is_s3 else None,
                retry_config=_RETRIES,
            )

    @staticmethod
    def key(kind: Kind, sha256: str, owner_id: str, suffix: str) -> str:
        """The key of a blob, such as ``source/ab/ab12…-vid_01….mp4``."""
        return f"{kind}/{sha256[:2]}/{sha256}-{owner_id}{suffix}"

    def put(self, path: Path, key: str, *, check: Callable[[], None] = copying.go_on) -> None:
        """Publish a finished file under its key, complete or not at all. The file at ``path`` goes away.

        ``check`` is called all the while that it is sent or copied, also while the store is silent, and ends it by
        raising. The store is told to forget what it has of it; once the last parts are on their way, they are waited
        for instead. One that has not done so within five seconds may keep unfinished parts, as of a process that is
        killed. Not to be called by an event loop.
        """
        if self._folder is None:
            with _bucket_known():
                copying.run(copying.send(self._store, key, path, check))
            path.unlink()
            return
        with _folder_known():
            self.check_mounted()
            target = self._folder / key
            _make_folder(target.parent, self._folder)
            try:
                _sync(path)
                path.replace(target)
            except FileNotFoundError:
                if not target.exists():
                    raise
                # moved by a try that failed after it
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                with _staged(self._folder) as staged:
                    copying.copy(path, staged, check)
                    _sync(staged)
                    staged.replace(target)
            _sync(target.parent)
            path.unlink(missing_ok=True)  # it was on another disk

    def check_mounted(self) -> None:
        """Raise `NotMountedError` when the blobs are in a local folder whose mark is gone; see `Storage`."""
        if self._folder is None:
            return
        with _folder_known():
            if (self._folder / _MARK).exists():
                self._has_mark = True
            elif self._has_mark or self._was_marked():
                raise NotMountedError(
                    f"the folder of the files has no {_MARK}: its disk is not mounted, or this is another folder; "
                    "`pvg-service adopt` makes it the one"
                )

    def exists(self, key: str) -> bool:
        """There is a blob of this key."""
        try:
            obstore.head(self._store, key)
        except FileNotFoundError:
            self.check_mounted()
            # what answers to HEAD does not say whether the bucket is there; listing raises when it is not
            for _ in obstore.list(self._store, key):
                pass
            return False
        return True

    def delete(self, key: str) -> None:
        """Remove a blob; nothing happens when there is none."""
        try:
            with _bucket_known():
                obstore.delete(self._store, key)
        except FileNotFoundError:
            self.check_mounted()

    async def stream(self, key: str, start: int, end: int) -> AsyncIterator[bytes]:
        """The bytes [start, end) of a blob, in pieces.

        Raises `BlobMissingError` before the first piece.
        """
        try:
            with _bucket_known():
                found = await obstore.get_async(self._store, key, options={"range": (start, end)})
        except FileNotFoundError as error:
            await asyncio.to_thread(self.check_mounted)
            raise BlobMissingError(key) from error
        return _pieces(found)

    def link(self, key: str, *, expires_in: timedelta) -> str | None:
        """A URL of the object store itself, signed by it, from which a blob may be had; None for a local folder."""
        if self._folder is not None:
            return None
        return str(obstore.sign(cast("SignCapableStore", self._store), "GET", key, expires_in))

    @contextmanager
    def local_path(
        self, key: str, *, job_id: str = "", folder: Path | None = None, check: Callable[[], None] = copying.go_on
    ) -> Iterator[Path]:
        """The blob as a local file: the very file in a local folder, else a copy for the time of the block.

        The copy carries the id of the job that it is made for, or is in a ``folder`` that is kept. ``check`` is called
        all the while that it is made, also while the store is silent, and ends it by raising. Raises what that raises,
        and `BlobMissingError`. The file must not be changed. Not to be called by an event loop.
        """
        if self._folder is not None:
            path = self._folder / key
            with _folder_known():
                is_there = path.is_file()
            if not is_there:
                self.check_mounted()
                raise BlobMissingError(key)
            yield path
            return
        path = self.spool.draft(Path(key).suffix, job_id=job_id)
        if folder is not None:
            path = folder / path.name
        try:
            try:
                with path.open("wb") as file, _bucket_known():
                    copying.run(copying.receive(self._store, key, file, check))
            except FileNotFoundError as error:
                raise BlobMissingError(key) from error
            yield path
        finally:
            path.unlink(missing_ok=True)

    def read_through(self, path: Path) -> None:
        """Read a file of `local_path` to its end.

        Raises `OSError` where that fails; of a local folder that does not answer an outage, and `BlobMissingError`.
        """
        if self._folder is None:
            copying.read_through(path)
            return
        try:
            with _folder_known():
                copying.read_through(path)
        except FileNotFoundError as error:
            self.check_mounted()
            raise BlobMissingError(path.name) from error

    def entries(self) -> Iterator[tuple[str, datetime]]:
        """Every blob's key and when it was written."""
        for batch in obstore.list(self._store):
            for entry in batch:
                if not (key := str(entry["path"])).startswith(_OUR_OWN):
                    yield key, entry["last_modified"]

    def mark(self) -> str | None:
        """What `set_mark` wrote last; None of a store that has no mark."""
        try:
            with _bucket_known():
                return bytes(obstore.get(self._store, _MARK).bytes()).decode(errors="replace")
        except FileNotFoundError:
            return None

    def set_mark(self, text: str) -> None:
        """Write a line into the store that says whose it is."""
        if self._folder is None:
            with _bucket_known():
                obstore.put(self._store, _MARK, text.encode())
            return
        with _staged(self._folder) as path:
            path.write_text(text)
            _sync(path)
            path.replace(self._folder / _MARK)
        _sync(self._folder)

    def clear_incoming(self, *, before: datetime) -> int:
        """Remove pieces of blobs that were last written to before ``before``, by a process that was killed.

        They are in a local folder only, and not among the `entries`. Returns their number.
        """
        if self._folder is None:
            return 0
        return _remove_old((self._folder / _INCOMING).glob("*"), before)

    def clear_former_pieces(self, *, before: datetime) -> int:
        """`clear_incoming` of what former versions left beside the blobs, as ``<key>#1``; looks at every blob."""
        if self._folder is None:
            return 0
        found = (path for kind in get_args(Kind) for path in (self._folder / kind).glob("*/*#*"))
        pieces = (path for path in found if is_key(re.sub(r"#\d+$", "", path.relative_to(self._folder).as_posix())))
        return _remove_old(pieces, before)

    def ping(self) -> None:
        """Raise when nothing can be written or read; `OSError` with its number when a local folder's disk is full."""
        if self._folder is not None:
            self.check_mounted()
            with _folder_known(), _staged(self._folder) as path:
                path.write_bytes(b"ok")
            return
        key = f"probe/{secrets.token_hex(8)}"
        with _bucket_known():
            obstore.put(self._store, key, b"ok")
            obstore.delete(self._store, key)


def is_key(key: str) -> bool:
    """True of what `Storage.key` makes, and `Storage.ping`; what else a store holds is not of this service."""
    return _KEY.fullmatch(key) is not None or _PROBE.fullmatch(key) is not None


def client_options(environment: Mapping[str, str]) -> ClientConfig:
    """How to speak to S3: patiently, unless the environment's `AWS_…` say otherwise."""
    given = {name: environment.get(f"AWS_{name.upper()}") for name in _OF_CLIENT}
    return cast("ClientConfig", {**_PATIENCE, **{name: value for name, value in given.items() if value}})


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """A path on the disk of the blobs to write at. What is there at the end goes away."""
    (folder / _INCOMING).mkdir(exist_ok=True)
    path = folder / _INCOMING / secrets.token_hex(16)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def _make_folder(folder: Path, top: Path) -> None:
    """Make a folder below ``top`` that is there after a power cut too."""
    if folder.is_dir():
        return
    folder.mkdir(parents=True, exist_ok=True)
    for parent in folder.parents:
        _sync(parent)
        if parent == top:
            return


def _sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk. File systems that cannot do that for folders are let be."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if not (path.is_dir() and error.errno in {errno.EBADF, errno.EINVAL, errno.ENOTSUP}):
            raise
    finally:
        os.close(descriptor)


def _remove_old(paths: Iterable[Path], before: datetime) -> int:
    removed = 0
    for path in paths:
        with suppress(FileNotFoundError):
            if path.is_file() and path.stat().st_mtime < before.timestamp():
                path.unlink()
                removed += 1
    return removed


@contextmanager
def _bucket_known() -> Iterator[None]:
    """Tell a bucket that is not there, of whose blobs nothing is known, from a blob that is missing."""
    try:
        yield
    except FileNotFoundError as error:
        if "NoSuchBucket" not in str(error):
            raise
        raise GenericError("the bucket does not exist") from error


@contextmanager
def _folder_known() -> Iterator[None]:
    """Tell a folder whose disk, or whose server, does not answer from one that is wrong."""
    try:
        yield
    except OSError as error:
        if error.errno not in _AWAY:
            raise
        raise GenericError(f"the folder of the files does not answer: {error.strerror}") from error


async def _pieces(found: obstore.GetResult) -> AsyncIterator[bytes]:
    async for piece in found.stream(min_chunk_size=CHUNK_BYTES):
        yield bytes(piece)
        await asyncio.sleep(0)  # a fast disk must not starve the other requests
