"""Files that a job has made, stored before they have a record: they go again unless they get one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from service.copying import file_sha256
from service.storage import Kind
from worker.run import Run

T = TypeVar("T")


@dataclass(frozen=True)
class StoredFile:
    """A file in the storage."""

    key: str
    sha256: str
    size_bytes: int


class Unpublished:
    """Stores files under the lease of a job. At the end of the block those that were not recorded are deleted."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._keys: list[str] = []

    def __enter__(self) -> Self:
        """Nothing is stored yet."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Delete what was not recorded."""
        if self._keys:
            self._run.blobs.discard(self._keys)

    def own(self, name: str) -> str:
        """A name of this attempt alone: two attempts never write, or clear away, each other's blob."""
        return f"{name}-{self._run.lease.token[:12]}"

    def store(self, kind: Kind, path: Path, name: str, suffix: str) -> StoredFile:
        """Store a file, which goes away. Raises what ends the run."""
        run = self._run
        run.keeper.check()
        sha256, size = file_sha256(path, run.keeper.check), path.stat().st_size
        key = run.storage.key(kind, sha256, name, suffix)
        self._keys.append(key)  # first: what is stored halfway is deleted as well
        run.patience(lambda: run.blobs.put(path, key, lease=run.lease, check=run.keeper.check))
        return StoredFile(key, sha256, size)

    def record(self, step: Callable[[], T]) -> T:
        """Have the files recorded by a step that ends the job; it answers None or False when the lease was lost."""
        self._run.keeper.flush()
        keys, self._keys = self._keys, []  # from here on they may have a record, also when no answer says so
        answer = self._run.patience(step)
        if answer is None or answer is False:
            self._keys = keys
        return answer
