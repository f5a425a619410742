"""One job being done, and what its work may use."""

from __future__ import annotations

import errno
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy.orm import Session

from pvg._processors import usable_processors
from service.blobs import Blobs
from service.catalog import Database, Job, Lease, Message
from service.settings import Settings
from service.storage import Storage
from worker.lease import LeaseKeeper
from worker.patience import Patience
from worker.progress import ProgressScale
from worker.sandbox import Limits, MethodError, Sandbox, View, Watch

T = TypeVar("T")


def media_limits(settings: Settings) -> dict[str, float]:
    """The limits of the settings, by the names of the method's `MediaLimits`."""
    return {
        "max_pixels": settings.max_pixels,
        "max_frames": settings.max_frames,
        "max_duration_s": settings.max_duration_s,
        "max_frame_rate": settings.max_frame_rate,
        "max_streams": settings.max_streams,
    }


@dataclass(kw_only=True)
class Run:
    """One job being done by this process."""

    settings: Settings
    database: Database
    storage: Storage
    blobs: Blobs
    job: Job
    lease: Lease
    keeper: LeaseKeeper
    progress: ProgressScale
    sandbox: Sandbox
    patience: Patience
    timings: dict[str, float] = field(default_factory=dict)
    began: float = field(default_factory=time.monotonic)
    drafts: ExitStack = field(default_factory=ExitStack)
    #: the key of each blob that was fetched, by its local file
    keys: dict[Path, str] = field(default_factory=dict)
    #: of the jobs that its work has made, to be published when it ends
    messages: list[Message] = field(default_factory=list)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Add the block's seconds to the job's timings."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.timings[name] = round(self.timings.get(name, 0.0) + time.perf_counter() - began, 3)

    def add_timings(self, seconds: Iterable[tuple[str, float]]) -> None:
        """Add these seconds to the job's timings, name by name."""
        for name, more in seconds:
            self.timings[name] = round(self.timings.get(name, 0.0) + more, 3)

    def read(self, call: Callable[[Session], T]) -> T:
        """What a call reads of the records. A database that is away is waited for."""

        def once() -> T:
            with self.database.read() as session:
                return call(session)

        return self.patience(once)

    @contextmanager
    def local_path(self, key: str) -> Iterator[Path]:
        """A blob as a local file; a copy of it carries the job's id. A storage that is away is waited for.

        Raises `BlobMissingError`, and what ends this run, also while the copy is made.
        """
        with ExitStack() as stack:
            local = partial(self.storage.local_path, key, job_id=self.job.id, check=self.keeper.check)
            path = self.patience(lambda: stack.enter_context(local()))
            self.keys[path] = key
            yield path

    def draft_folder(self) -> Path:
        """A temporary folder that is cleared with its files when the run ends, whatever its end."""
        path = self.storage.spool.draft(job_id=self.job.id)
        self.drafts.callback(shutil.rmtree, path, ignore_errors=True)
        path.mkdir()
        return path

    def call(self, name: str, arguments: Mapping[str, Any], *, read: Sequence[Path], folder: Path) -> Any:
        """Make a call of `worker.sandbox.calls` in a process that sees these files and writes into this folder alone.

        It is told besides what memory it may take and what clips must keep. Its answer is not checked. Raises what
        `Sandbox.call` raises, what ends this run, its time limit too, `BlobMissingError`, and `OSError` for a fault of
        the disk or the shared folder that the files are on, once they can be read again.
        """
        settings = self.settings
        limits = Limits(
            memory_bytes=settings.job_memory_bytes,
            cpu_s=int(settings.job_soft_limit_s * usable_processors()) + 1,
            file_bytes=settings.job_file_bytes,
        )
        watch = Watch(self.keeper.check, self.progress, self.began + settings.job_soft_limit_s)
        view = View(tuple(path.resolve() for path in read), folder.resolve())
        shared = {"memory_bytes": limits.memory_bytes, "limits": media_limits(settings)}
        try:
            return self.sandbox.call(name, {**arguments, **shared}, limits=limits, view=view, watch=watch)
        except MethodError as error:
            if error.fault and (self._wait_for(read) or error.fault == "certain"):
                raise OSError(errno.EIO, "a file of the job could not be read or written") from error
            error.fault = None  # it is of the file, which is there
            raise

    def _wait_for(self, paths: Sequence[Path]) -> bool:
        """Read files to their ends, and wait for a storage that does not answer. Whether it was waited for."""
        tries = 0

        def once() -> None:
            nonlocal tries
            tries += 1
            for path in paths:
                self.storage.read_through(path)

        self.patience(once)
        return tries > 1
