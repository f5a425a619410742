"""One request for a picture after the other: taken, made in the sandbox, stored for a moment, reported."""

from __future__ import annotations

import os
import shutil
import stat
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Final

import structlog

from service.blobs import Blobs, was_marked
from service.catalog import Database, Preview, media, previews, still_request
from service.catalog.previews import KEPT_S, Still
from service.copying import file_sha256
from service.ids import new_id
from service.outages import is_outage, told
from service.room import Room
from service.settings import Settings
from service.spool import Spool
from service.storage import BlobMissingError, Storage
from worker.answers import StillAnswer, checked, made
from worker.failures import AssetLostError, SourceLostError, is_expected, problem_of_picture
from worker.previews.open_clips import Clip, OpenClips
from worker.previews.turns import Turns
from worker.sandbox import CrashError, MethodError, Sandbox

log = structlog.get_logger(__name__)

SUFFIXES: Final = {"jpeg": ".jpg", "png": ".png"}


class Previewer:
    """Makes pictures, several at once in several threads. Media are decoded in the processes of ``sandbox``."""

    def __init__(self, settings: Settings, sandbox: Sandbox) -> None:
        self._settings = settings
        self._database = Database(settings.database, before_freeing=Room(settings).give_back)
        self._storage = Storage(settings, was_marked=partial(was_marked, self._database))
        # never recorded as a result: the tombstone ends it
        self._blobs = Blobs(self._database, self._storage, within_s=KEPT_S)
        self._clips = OpenClips(settings, self._storage, sandbox, self._assets)
        self._turns = Turns(self._database, settings.preview_timeout_s)

    def start(self) -> None:
        """Begin to look after what is open."""
        self._clips.start()

    def stop(self) -> None:
        """Close what is open."""
        self._clips.stop()
        self._database.close()

    def take_turn(self) -> None:
        """Make the picture that is next, if somebody waits for one, and those whose turn was put off meanwhile.

        While the database or the storage is away, nobody is told: who waits asks again.
        """
        try:
            self._take_turn()
        except Exception as error:
            if not is_outage(error):
                raise
            log.warning("pictures are not made: what they need is away", **told(error))

    def _take_turn(self) -> None:
        preview = self._turns.begin()
        while preview is not None:
            try:
                self._work_on(preview)
            finally:
                self._turns.end(preview)
            preview = self._turns.go_on()

    def _work_on(self, preview: Preview) -> None:
        """Make a picture. What goes wrong is told to who waits."""
        began = time.monotonic()
        clip = self._clip_of(preview)
        if clip is None:
            return
        try:
            still = self._make(preview, clip, began + self._settings.preview_timeout_s)
        except Exception as error:
            if not is_expected(error):
                trace = error.trace if isinstance(error, MethodError) else None
                log.exception("a picture could not be made", preview=preview.id, trace=trace)
            with self._database.write() as session:
                previews.fail(session, preview.id, problem_of_picture(error))
            return
        with self._database.write() as session:
            kept = previews.finish(session, preview.id, still)
        if not kept:  # its medium was deleted meanwhile
            self._blobs.discard([still.key])
        log.info("picture made", preview=preview.id, seconds=round(time.monotonic() - began, 3))

    def _clip_of(self, preview: Preview) -> Clip | None:
        with self._database.read() as session:
            medium = media.get(session, preview.media_id)
            reference = media.get(session, preview.reference_id) if preview.reference_id is not None else None
        if medium is None or (preview.reference_id is not None and reference is None):
            return None  # deleted, and the request with it
        return Clip(medium, reference)

    def _make(self, preview: Preview, clip: Clip, until: float) -> Still:
        request = still_request(preview)
        suffix = SUFFIXES[request.format]
        name = f"{new_id('prv')}{suffix}"
        try:
            answer, path = self._clips.ask(clip, asdict(request), name, until)
        except BlobMissingError as error:
            raise _lost(clip, str(error)) from error
        try:
            frame = checked(StillAnswer, answer).frame
            return self._store(made(path.parent, path.name), preview, suffix, frame)
        finally:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def _store(self, path: Path, preview: Preview, suffix: str, frame: int) -> Still:
        draft = copied(path, self._storage.spool)
        try:
            size = draft.stat().st_size
            key = self._storage.key("preview", file_sha256(draft), preview.id, suffix)
            self._blobs.put(draft, key)
        finally:
            draft.unlink(missing_ok=True)
        return Still(key, size, frame)

    def _assets(self, media_ids: set[str]) -> Mapping[str, str | None]:
        with self._database.read() as session:
            return media.assets(session, media_ids)


def copied(path: Path, spool: Spool) -> Path:
    """A draft with the content of a file that a process has made, which goes on, and may have it open.

    Raises `CrashError` for what is no plain file: by now there may be another thing in its place.
    """
    # without O_NONBLOCK a pipe would be waited for
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_nlink != 1:
            raise CrashError(f"its process made no plain file {path.name}")
        draft, file = spool.new_draft()
        try:
            with file, open(descriptor, "rb", closefd=False) as made_there:
                shutil.copyfileobj(made_there, file)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
    finally:
        os.close(descriptor)
    return draft


def _lost(clip: Clip, key: str) -> Exception:
    """What to tell when the storage has no blob of this key."""
    if key == clip.medium.source_key:
        return SourceLostError(clip.medium.id)
    whose = [media_id for media_id, asset in clip.media.items() if asset == key]
    return AssetLostError(", ".join(whose) or clip.medium.id)
