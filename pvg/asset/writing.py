"""Writing an asset, frame by frame."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pvg._targets import begin_draft, draft_of
from pvg.asset.arrays import CHUNK_FRAMES, FORMAT_VERSION, FRAME_ARRAYS, MATTES, decode, encode, to_bytes
from pvg.asset.checking import PLACES, Reach, check_chunk, check_keys, check_manifest, entry_limit
from pvg.asset.records import FaceRecord

MANIFEST = "manifest.json"
_LEVEL = 6  # of either method


class AssetWriter:
    """Write an asset chunk by chunk; `finish` publishes it under its name, leaving without it removes it.

    Arrays and a manifest that no reader would take are refused as they are written, and by `finish` places that are far
    from the picture, whose size it is told: `ValueError`, of a manifest `TypeError` and `KeyError` too.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._temporary = draft_of(self.path)
        self._zip: zipfile.ZipFile
        self._entries: dict[str, str] = {}
        self._pending: dict[int, dict[str, list[NDArray[Any]]]] = {}
        self._chunks: dict[int, int] = {}
        self._reach: dict[int, dict[str, Reach]] = {}  # of what was written of each track, by array
        self._faces: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        try:
            begin_draft(self._temporary, self.path)
            self._zip = zipfile.ZipFile(self._temporary, "w", zipfile.ZIP_DEFLATED)
        except BaseException:  # a signal, too, that comes as soon as the file is there
            self._temporary.unlink(missing_ok=True)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._zip.close()
        finally:  # on a full disk even closing raises
            self._temporary.unlink(missing_ok=True)

    def add_frame(self, track: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Append one frame of a track: an array for each of `FRAME_ARRAYS`, of the shapes that `checking` has."""
        pending = self._pending.setdefault(track, {name: [] for name in FRAME_ARRAYS})
        for name in FRAME_ARRAYS:
            pending[name].append(arrays[name])
        if len(pending["score"]) == CHUNK_FRAMES:
            self._flush(track)

    def end_track(self, track: int) -> None:
        """Write what waits of a track that has no more frames, now rather than with its face."""
        if self._pending.get(track, {}).get("score"):
            self._flush(track)
        self._pending.pop(track, None)

    def drop_track(self, track: int) -> None:
        """Leave out what was added of a track that turned out to be no face; its bytes stay, and nobody reads them."""
        self._pending.pop(track, None)
        for name in [name for name in self._entries if name.startswith(f"track{track}/")]:
            del self._entries[name]
        self._reach.pop(track, None)

    def add_face(self, record: FaceRecord, track: int | None = None) -> None:
        """Close a face: flush its frames and write its key frames. Faces are added in the order of their indices.

        track: the number its frames were added under, its index when None. Tracks are numbered as they are found and
        faces when all are known.
        """
        track = record.summary.index if track is None else track
        self.end_track(track)
        keys = record.key_frames
        for name in ("colors", "visible", "parts"):
            self._of_keys(f"track{track}/{name}", name, np.stack([getattr(key, name) for key in keys]), len(keys))
        for k, key in enumerate(keys):
            self._of_keys(f"track{track}/skin/{k:06d}", "skin", key.skin, len(key.skin))
            self._of_keys(f"track{track}/skin_at/{k:06d}", "skin_at", key.skin_at, len(key.skin))
        key_frames = [key.frame for key in record.key_frames]
        since = [key.since for key in record.key_frames]
        entry = {"track": track, "key_frames": key_frames, "key_frames_since": since}
        around = {"haze": record.haze, "warmth": record.warmth}
        self._faces.append({**asdict(record.summary), **entry, **around})

    def finish(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest and move the file to its name."""
        body = {"format": FORMAT_VERSION, **manifest, "faces": self._faces, "entries": self._entries}
        check_manifest(json.loads(json.dumps(body)))  # as it will be read
        for reaches in self._reach.values():
            for reach in reaches.values():
                reach.check(max(body["media"]["width"], body["media"]["height"]))
        _write_manifest(self._zip, body)
        self._zip.close()
        self._temporary.replace(self.path)

    def _flush(self, track: int) -> None:
        chunk = self._chunks.get(track, 0)
        for name, rows in self._pending[track].items():
            values = encode(name, np.stack(rows))
            check_chunk(name, values, len(rows))
            self._array(f"track{track}/{name}/{chunk:06d}", values)
            if name in PLACES:
                reach, known = Reach.of(name, decode(name, values)), self._reach.setdefault(track, {})
                known[name] = reach.joined(known.get(name, reach))
            rows.clear()
        self._chunks[track] = chunk + 1

    def _of_keys(self, entry: str, name: str, array: NDArray[Any], count: int) -> None:
        check_keys(name, array, count)
        self._array(entry, array)

    def _array(self, name: str, array: NDArray[Any]) -> None:
        data = to_bytes(array)
        if len(data) > entry_limit(name):
            raise ValueError(f"entry {name} has {len(data)} bytes, more than are read")
        # blocks of like bytes, as mattes are, are a third smaller by bzip2 [measured: 26.7 against 40.5 kB]
        method = zipfile.ZIP_BZIP2 if name.split("/")[1] in MATTES else zipfile.ZIP_DEFLATED
        _write_entry(self._zip, name, data, method)
        self._entries[name] = hashlib.sha256(data).hexdigest()


def replace_manifest(path: Path, manifest: Mapping[str, Any]) -> None:
    """Give a whole asset file another manifest in place: it is the last entry, so nothing else is written again."""
    with zipfile.ZipFile(path) as asset:
        last = asset.infolist()[-1]
        if last.filename != MANIFEST:
            raise ValueError(f"{path.name} does not end with its manifest")
    with zipfile.ZipFile(path, "a") as asset:
        asset.filelist.remove(asset.NameToInfo.pop(MANIFEST))
        asset.start_dir = last.header_offset  # where the next entry goes, and the directory after it
        _write_manifest(asset, manifest)


def _write_manifest(asset: zipfile.ZipFile, manifest: Mapping[str, Any]) -> None:
    data = json.dumps(manifest, indent=1).encode()
    _write_entry(asset, MANIFEST, data)
    asset.comment = hashlib.sha256(data).hexdigest().encode()


def _write_entry(asset: zipfile.ZipFile, name: str, data: bytes, method: int = zipfile.ZIP_DEFLATED) -> None:
    # a fixed date: the same clip gives the same bytes
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    asset.writestr(entry, data, method, _LEVEL)
