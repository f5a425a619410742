"""Clips that are open for single pictures: each in a confined process that stays for a while."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import structlog

from service.catalog import Media
from service.settings import Settings
from service.storage import Storage
from worker.failures import without_files
from worker.previews.copies import Blob, Copies
from worker.run import media_limits
from worker.sandbox import CrashError, LimitError, Limits, MethodError, Sandbox, Session, View

log = structlog.get_logger(__name__)

#: seconds between two looks at what is open
_LOOK_S: Final = 1.0
#: processor time after which a process is replaced
_CPU_S: Final = 3600
#: of a picture: one of the largest size as PNG
_FILE_BYTES: Final = 512 * 2**20


@dataclass(frozen=True)
class Clip:
    """A medium, and a reference for it if there is one: all that one process sees."""

    medium: Media
    reference: Media | None

    @property
    def key(self) -> tuple[str | None, ...]:
        """What it is known by: an asset that was made again is another one."""
        reference = self.reference
        return (self.medium.id, self.medium.asset_key, *((reference.id, reference.asset_key) if reference else ()))

    @property
    def media(self) -> dict[str, str | None]:
        """The asset of each medium, by its id."""
        both = (self.medium, self.reference)
        return {one.id: one.asset_key for one in both if one is not None}


@dataclass(eq=False)
class _Entry:
    clip: Clip
    lock: threading.Lock = field(default_factory=threading.Lock)
    session: Session | None = None
    folder: Path = Path()
    #: of its blobs, by their local files
    keys: dict[Path, str] = field(default_factory=dict)
    held: ExitStack = field(default_factory=ExitStack)
    users: int = 0
    used_at: float = 0.0


class OpenClips:
    """The clips that are open. Several threads may ask; of one clip, one after the other.

    ``present`` tells the assets of those media that are still there: a clip of a deleted one is closed.
    """

    def __init__(
        self,
        settings: Settings,
        storage: Storage,
        sandbox: Sandbox,
        present: Callable[[set[str]], Mapping[str, str | None]],
    ) -> None:
        self._settings = settings
        self._storage = storage
        self._sandbox = sandbox
        self._present = present
        # files of a folder are used where they are
        self._copies = Copies(settings, storage) if settings.local_storage_folder is None else None
        self._entries: dict[tuple[str | None, ...], _Entry] = {}
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="open-clips", daemon=True)

    def start(self) -> None:
        """Begin to close what is not used any more."""
        self._thread.start()

    def stop(self) -> None:
        """Close all clips that nobody uses right now."""
        self._stop.set()
        self._thread.join()
        for entry in self._idle(lambda _: True):
            self._close(entry)
        if self._copies is not None:
            self._copies.close()

    def ask(self, clip: Clip, question: Mapping[str, Any], name: str, until: float) -> tuple[Any, Path]:
        """The answer to a question about a clip, not checked, and where the file ``name`` that it makes is.

        The file is the caller's. Raises what `Session.ask` and `Storage.local_path` raise, and `TimeLimitError` too
        when the clip's files have not come from an object store by ``until``; they are kept for the next question.
        """
        with self._lock:
            entry = self._entries.setdefault(clip.key, _Entry(clip))
            entry.users += 1
        try:
            with entry.lock:
                return self._ask(entry, question, name, until)
        finally:
            with self._lock:
                entry.users -= 1
                entry.used_at = time.monotonic()

    def _ask(self, entry: _Entry, question: Mapping[str, Any], name: str, until: float) -> tuple[Any, Path]:
        was_open = entry.session is not None
        try:
            session = entry.session or self._open(entry, until)
            return session.ask({**question, "path": str(entry.folder / name)}, until), entry.folder / name
        except MethodError as error:  # of this question; the clip stays open
            with suppress(OSError):
                (entry.folder / name).unlink(missing_ok=True)
            media = [one for one in (entry.clip.medium, entry.clip.reference) if one is not None]
            raise without_files(error, media, entry.keys) from error
        except (CrashError, LimitError):  # it was killed, or has used up what a process may
            self._end(entry)
            if not was_open or time.monotonic() >= until:
                raise
            log.info("the process of a clip that was open is gone; another one is begun")
            return self._ask(entry, question, name, until)
        except BaseException:
            self._end(entry)
            raise

    def _open(self, entry: _Entry, until: float) -> Session:
        with self._lock:
            open_ones = sum(one is not entry and one.session is not None for one in self._entries.values())
        too_many = max(0, open_ones + 1 - self._settings.preview_open_clips)
        idle = self._idle(lambda one: one is not entry and one.session is not None)
        for other in sorted(idle, key=lambda one: one.used_at)[:too_many]:
            self._close(other)
        with ExitStack() as stack:
            blobs = _blobs(entry.clip)
            paths = self._files(stack, blobs, until)
            entry.keys = dict(zip(paths, (blob.key for blob in blobs), strict=True))
            folder, descriptor = self._storage.spool.new_folder()
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
            stack.callback(os.close, descriptor)
            source, asset, *reference = paths
            limits = Limits(self._settings.job_memory_bytes, _CPU_S, _FILE_BYTES)
            arguments = {
                "source": str(source),
                "asset": str(asset),
                "reference": str(reference[0]) if reference else None,
                "limits": media_limits(self._settings),
            }
            view = View(tuple(paths), folder.resolve())
            entry.session = self._sandbox.open("stills", arguments, limits=limits, view=view, until=until)
            stack.callback(entry.session.close)
            entry.folder, entry.held = folder.resolve(), stack.pop_all()
        return entry.session

    def _files(self, stack: ExitStack, blobs: list[Blob], until: float) -> list[Path]:
        if self._copies is not None:
            return stack.enter_context(self._copies.held(blobs, until))
        return [stack.enter_context(self._storage.local_path(blob.key)).resolve() for blob in blobs]

    def _run(self) -> None:
        while not self._stop.wait(_LOOK_S):
            try:
                self._close_unneeded()
            except Exception as error:  # the next look may go well
                log.warning("clips that are open could not be looked through", error=type(error).__name__)

    def _close_unneeded(self) -> None:
        with self._lock:
            ids = {media_id for entry in self._entries.values() for media_id in entry.clip.media}
        if self._copies is not None:
            ids |= self._copies.media_ids
        if not ids:
            return
        before = time.monotonic() - self._settings.preview_idle_s
        late = self._idle(lambda entry: entry.used_at < before)
        for entry in late:
            self._close(entry)
        if self._copies is not None:
            self._copies.drop_old()
        present = self._present(ids)
        for entry in self._idle(lambda entry: any(present.get(id_) != key for id_, key in entry.clip.media.items())):
            self._close(entry)
        if self._copies is not None:
            self._copies.drop_deleted(present)

    def _idle(self, wanted: Callable[[_Entry], bool]) -> list[_Entry]:
        """Those of the clips that nobody uses right now."""
        with self._lock:
            return [entry for entry in self._entries.values() if not entry.users and wanted(entry)]

    def _close(self, entry: _Entry) -> None:
        """Close a clip, unless somebody has begun to use it."""
        with self._lock:
            if entry.users or self._entries.get(entry.clip.key) is not entry:
                return
            del self._entries[entry.clip.key]
        with entry.lock:
            self._end(entry)

    def _end(self, entry: _Entry) -> None:
        entry.held.close()
        entry.session = None


def _blobs(clip: Clip) -> list[Blob]:
    """Source and asset of the medium, and the asset of the reference."""
    medium, reference = clip.medium, clip.reference
    found = [(medium.source_key, medium), (medium.asset_key, medium)]
    if reference is not None:
        found.append((reference.asset_key, reference))
    return [Blob(key, one.id, one.asset_key) for key, one in found if key is not None]
