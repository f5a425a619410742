"""Blobs: immutable files named by the hash of their content, in a local folder or an object store.

A key holds the content's sha256 and the id of the record that owns the blob. Two records never share a blob, so
deleting one needs no counting of users and cannot race with another upload of the same bytes.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import secrets
from collections.abc import AsyncIterator, Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Literal

import obstore
from obstore.store import LocalStore, ObjectStore, from_url

from service.ids import JOB_ID
from service.settings import Settings

Kind = Literal["source", "asset", "result"]

CHUNK_BYTES = 256 * 1024


class BlobMissingError(Exception):
    """The storage has no blob of this key."""


class Storage:
    """The blobs of one service."""

    def __init__(self, settings: Settings) -> None:
        self._folder = settings.local_storage_folder
        self._spool = settings.spool_folder
        self._spool.mkdir(parents=True, exist_ok=True)
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._store: ObjectStore = LocalStore(self._folder)
        else:
            self._store = from_url(settings.storage_url)

    @staticmethod
    def key(kind: Kind, sha256: str, owner_id: str, suffix: str) -> str:
        """The key of a blob, such as ``source/ab/ab12…-vid_01….mp4``."""
        return f"{kind}/{sha256[:2]}/{sha256}-{owner_id}{suffix}"

    def draft(self, suffix: str = "", *, job_id: str = "") -> Path:
        """A fresh temporary path to write a file at. Nobody sees it until `put` publishes it."""
        return self._spool / f"{job_id}{'-' if job_id else ''}{secrets.token_hex(16)}{suffix}"

    def put(self, path: Path, key: str) -> None:
        """Publish a finished file under its key, complete or not at all. The file at ``path`` goes away."""
        if self._folder is None:
            obstore.put(self._store, key, path)
            path.unlink()
            return
        target = self._folder / key
        target.parent.mkdir(parents=True, exist_ok=True)
        with path.open("rb") as file:
            os.fsync(file.fileno())
        try:
            path.replace(target)
        except OSError as error:
            if error.errno != 18:  # EXDEV: the spool is on another disk
                raise
            obstore.put(self._store, key, path)
            path.unlink()

    def delete(self, key: str) -> None:
        """Remove a blob; nothing happens when there is none."""
        with suppress(FileNotFoundError):
            obstore.delete(self._store, key)

    async def stream(self, key: str, start: int, end: int) -> AsyncIterator[bytes]:
        """The bytes [start, end) of a blob, in pieces.

        Raises `BlobMissingError` before the first piece.
        """
        try:
            found = await obstore.get_async(self._store, key, options={"range": (start, end)})
        except FileNotFoundError as error:
            raise BlobMissingError(key) from error
        return _pieces(found)

    @contextmanager
    def local_path(self, key: str) -> Iterator[Path]:
        """The blob as a local file: the very file in a local folder, else a copy for the time of the block.

        Raises `BlobMissingError`. The file must not be changed.
        """
        if self._folder is not None:
            path = self._folder / key
            if not path.is_file():
                raise BlobMissingError(key)
            yield path
            return
        path = self.draft(Path(key).suffix)
        try:
            try:
                with path.open("wb") as file:
                    for piece in obstore.get(self._store, key).stream(min_chunk_size=CHUNK_BYTES):
                        file.write(piece)
            except FileNotFoundError as error:
                raise BlobMissingError(key) from error
            yield path
        finally:
            path.unlink(missing_ok=True)

    def entries(self) -> Iterator[tuple[str, datetime]]:
        """Every blob's key and when it was written."""
        for batch in obstore.list(self._store):
            for entry in batch:
                yield str(entry["path"]), entry["last_modified"]

    def ping(self) -> None:
        """Raise when nothing can be written or read."""
        key = f"probe/{secrets.token_hex(8)}"
        obstore.put(self._store, key, b"ok")
        obstore.delete(self._store, key)

    def clear_drafts(self, *, held: Callable[[Collection[str]], Collection[str]], before: datetime) -> int:
        """Remove the temporary files whose writer is gone. Returns their number.

        They may hold a face, so they must not outlive what they were made from. A job is claimed before its first draft
        is made, and its last one is published or removed before it ends: a draft whose job is not among those that
        ``held`` returns, of the ids it is given, was left by a process that was killed. Any other draft is removed when
        it was last touched before ``before``.
        """
        by_job: dict[str, list[Path]] = {}
        old: list[Path] = []
        for path in self._spool.iterdir():
            # a file that was named after a draft carries its job's id too
            if owner := JOB_ID.search(path.name):
                by_job.setdefault(owner[0], []).append(path)
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < before.timestamp():
                    old.append(path)
        kept = held(by_job.keys()) if by_job else ()
        gone = [path for job_id, paths in by_job.items() if job_id not in kept for path in paths]
        removed = 0
        for path in (*gone, *old):
            with suppress(FileNotFoundError):
                path.unlink()
                removed += 1
        return removed


async def _pieces(found: obstore.GetResult) -> AsyncIterator[bytes]:
    async for piece in found.stream(min_chunk_size=CHUNK_BYTES):
        yield bytes(piece)
        await asyncio.sleep(0)  # a fast disk must not starve the other requests


def file_sha256(path: Path) -> str:
    """The sha256 of a file as hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
