"""Reading an asset by frame, every entry checked when it is read."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg._checks import whole_number
from pvg._targets import begin_draft, check_file, draft_of
from pvg.asset.arrays import CHUNK_FRAMES, FORMAT_VERSION, FRAME_ARRAYS, decode, from_bytes
from pvg.asset.checking import PLACES, Reach, check_chunk, check_keys, check_manifest, entry_limit
from pvg.asset.entries import DAMAGE, Entries
from pvg.asset.records import FaceInFrame, FaceRecord, FaceSummary, KeyFrame, MediaSummary
from pvg.asset.source import find_source as found_source
from pvg.asset.source import source_note
from pvg.asset.writing import replace_manifest
from pvg.curves import boundary_points
from pvg.errors import AssetError
from pvg.face import Landmarks
from pvg.skin import Matte
from pvg.video import MediaLimits, SingleFrames, sha256_file

_CACHED_CHUNKS = 4  # of each face that a frame may have


def _face_from_json(values: Mapping[str, Any]) -> FaceSummary:
    known = {field.name: values[field.name] for field in fields(FaceSummary)}
    known["skin_rgb"], known["warnings"] = tuple(known["skin_rgb"]), tuple(known["warnings"])
    return FaceSummary(**known)


class VectorVideo:
    """A vectorised clip or image: its geometry, boundary colours and mattes, open for reading by frame.

    Made by `pvg.vectorize` and `pvg.open_asset`. A context manager; closing it removes a temporary asset, and so does
    the end of the process, but for a process that was forked from the one that made it.
    limits: what the source clip must keep whenever it is read, as when it was vectorised; None for the usual ones.

    path: of the asset;  source: of the clip, None where none is known, both absolute;  media: what the clip is;
    faces: a summary of each, by index;  shots: first frames;  settings: those of `vectorize` that it was made with;
    source_sha256: of the clip's bytes, hexadecimal;  manifest: all of this as it is stored;  single_frames: the clip's,
    whose file stays open once one was asked for.
    """

    def __init__(
        self,
        path: str | Path,
        source: str | Path | None = None,
        *,
        limits: MediaLimits | None = None,
        temporary: bool = False,
    ) -> None:
        # absolute: the process may go to another folder before they are read
        self.path = Path(path).absolute()
        self.source = None if source is None else Path(source).absolute()
        self.limits = limits or MediaLimits()
        self.single_frames = SingleFrames()
        self._source_checked = False
        # at the end of the process too, when an object that something still refers to is not collected
        self._removal = weakref.finalize(self, _remove, self.path, os.getpid()) if temporary else None
        self._cache: dict[str, NDArray[Any]] = {}  # the one read longest ago first
        self._lock = Lock()  # of the cache: frames may be read by several threads
        try:
            self._file = Entries(self.path)
        except FileNotFoundError:
            raise AssetError(f"no asset file at {self.path}") from None
        except DAMAGE as error:
            raise AssetError(f"{self.path.name} is not an asset or is truncated ({error})") from None
        try:
            self._read_manifest()
        except BaseException:
            self._file.close()
            raise

    def _read_manifest(self) -> None:
        digest = self._file.comment.decode("ascii", "replace")
        data = self._read("manifest.json", digest, self._file.manifest_limit)
        try:
            manifest = json.loads(data)
            version = manifest["format"]
            if version != FORMAT_VERSION:
                raise AssetError(
                    f"{self.path.name} has asset format {version}, this library reads {FORMAT_VERSION}; "
                    "vectorise the clip again"
                )
            if manifest["faces"] == []:
                raise AssetError(f"{self.path.name} has no face; vectorise a clip or portrait that shows one")
            check_manifest(manifest)
            self.manifest: dict[str, Any] = manifest
            self._entries: dict[str, str] = manifest["entries"]
            media = manifest["media"]
            self.media = MediaSummary(**media | {"warnings": tuple(media.get("warnings", ()))})
            self.source_sha256: str = manifest["source_sha256"]
            # assets made before there were others do not say their input colour
            self.settings: dict[str, Any] = {"input_color": "auto"} | manifest["settings"]
            self.shots: tuple[int, ...] = tuple(manifest["shots"])
            self.faces: tuple[FaceSummary, ...] = tuple(_face_from_json(face) for face in manifest["faces"])
            self._tracks = tuple(int(face["track"]) for face in manifest["faces"])
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
            raise AssetError(f"the manifest of {self.path.name} is malformed ({error!r})") from None

    def __repr__(self) -> str:
        media = self.media
        what = f"{media.width}x{media.height}, {media.frame_count} frames, {len(self.faces)} faces"
        return f"<VectorVideo {self.path.name}: {what}>"

    def __reduce__(self) -> NoReturn:
        # a copy would share the open file, and close it for both
        raise TypeError(f"{self!r} holds open files and is neither copied nor pickled: pvg.open_asset opens it again")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        with contextlib.suppress(AttributeError):  # a constructor that raised has nothing to close
            self.close()

    def close(self) -> None:
        """Close the files; a temporary asset is removed by the process that made it. Twice is harmless."""
        self.single_frames.close()
        self._file.close()
        if self._removal is not None:
            self._removal()

    def save(self, path: str | Path) -> None:
        """Copy the asset file to `path`, appearing there only when complete; the copy notes where its clip lies.

        Raises `ValueError` where that would replace the clip, `OSError` where it cannot be written, and `AssetError`
        once it was closed.
        """
        self._check_open()
        target = Path(path)
        check_file(target, [self.source])
        draft = draft_of(target)
        try:
            begin_draft(draft, target)
            with draft.open("wb") as out:
                self._file.copy_to(out)
            if self.source is not None:
                replace_manifest(draft, {**self.manifest, **source_note(self.source, target)})
            draft.replace(target)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise

    @property
    def frame_count(self) -> int:
        """Number of frames of the clip, counted while vectorising; of a reference, of those that were looked at."""
        return self.media.frame_count

    @property
    def persons(self) -> tuple[tuple[int, ...], ...]:
        """The faces of each person, the one seen longest first: one transport serves them all."""
        grouped: dict[int, list[FaceSummary]] = {}
        for face in self.faces:
            grouped.setdefault(face.person, []).append(face)
        for faces in grouped.values():
            faces.sort(key=lambda face: (face.first_frame - face.last_frame, face.index))
        return tuple(tuple(face.index for face in grouped[person]) for person in sorted(grouped))

    @cached_property
    def records(self) -> tuple[FaceRecord, ...]:
        """Every face with its key frames."""
        out = []
        for face, track, raw in zip(self.faces, self._tracks, self.manifest["faces"], strict=True):
            count = len(raw["key_frames"])
            colors, visible, parts = (self._of_keys(track, name, count) for name in ("colors", "visible", "parts"))
            keys = zip(raw["key_frames"], colors, visible, parts, raw["key_frames_since"], strict=True)
            frames = tuple(
                KeyFrame(f, c, v, *self._skin_of_key(track, k), p, last) for k, (f, c, v, p, last) in enumerate(keys)
            )
            out.append(FaceRecord(face, frames, raw.get("haze", 0), raw.get("warmth", 0)))
        return tuple(out)

    def _of_keys(self, track: int, name: str, count: int) -> NDArray[Any]:
        return self._array(f"track{track}/{name}", lambda array: check_keys(name, array, count))

    def _skin_of_key(self, track: int, key: int) -> tuple[Floats, NDArray[np.int16]]:
        skin = self._array(f"track{track}/skin/{key:06d}", lambda array: check_keys("skin", array, len(array)))
        count = len(skin)
        skin_at = self._array(f"track{track}/skin_at/{key:06d}", lambda array: check_keys("skin_at", array, count))
        return skin, skin_at

    def face_at(self, face: int, frame: int) -> FaceInFrame | None:
        """What `face` is in `frame`, None outside its track. Raises `AssetError` when altered."""
        summary = self.faces[face]
        if not summary.first_frame <= frame <= summary.last_frame:
            return None
        track = self._tracks[face]
        chunk, row = divmod(frame - summary.first_frame, CHUNK_FRAMES)
        rows = min(CHUNK_FRAMES, summary.last_frame - summary.first_frame + 1 - chunk * CHUNK_FRAMES)
        part = {name: self._chunk(f"track{track}/{name}/{chunk:06d}", name, rows)[row] for name in FRAME_ARRAYS}
        landmarks = Landmarks(part["points"], part["skin_points"])
        return FaceInFrame(
            landmarks=landmarks,
            boundary=boundary_points(part["radius"], landmarks.axes),
            score=float(part["score"][0]),
            pose=part["pose"],
            matte=Matte.over(part["box"], part["matte"]),
            body=Matte.over(self._picture_box, part["body"]),
        )

    @property
    def _picture_box(self) -> Floats:
        return np.array([0, 0, self.media.width, self.media.height], np.float32)

    @cached_property
    def _most_at_once(self) -> int:
        """The most faces that any frame has."""
        changes = [(face.first_frame, 1) for face in self.faces] + [(face.last_frame + 1, -1) for face in self.faces]
        return max(itertools.accumulate(change for _, change in sorted(changes)))

    def landmarks(self, face: int) -> Floats:
        """(frames of the track, 106, 2) float32 landmarks in source pixels."""
        summary = self.faces[face]
        count, track = summary.last_frame - summary.first_frame + 1, self._tracks[face]
        parts = [
            self._decoded(
                f"track{track}/points/{start // CHUNK_FRAMES:06d}", "points", min(CHUNK_FRAMES, count - start)
            )
            for start in range(0, count, CHUNK_FRAMES)
        ]
        return np.concatenate(parts)

    def require_source(self) -> Path:
        """The source clip, checked once against the manifest's sha256.

        Raises `AssetError` when it was not given, is gone or is another file.
        """
        if self.source is None:
            raise AssetError(f"{self.path.name} was opened without its source clip, which rendering needs")
        if not self.source.is_file():
            raise AssetError(f"the source clip {self.source.name} of {self.path.name} is missing")
        if not self._source_checked and sha256_file(self.source) != self.source_sha256:
            raise AssetError(f"{self.source.name} is not the clip that {self.path.name} was made from")
        self._source_checked = True
        return self.source

    def verify(self) -> None:
        """Read every entry and check its digest; the clip is not looked at. Raises `AssetError`."""
        for name in self._entries:
            self._array(name)

    def summary(self) -> dict[str, Any]:
        """A JSON-able description: media, faces, shots and settings."""
        return {
            "format": FORMAT_VERSION,
            "source_sha256": self.source_sha256,
            "media": asdict(self.media),
            "shots": list(self.shots),
            "settings": self.settings,
            "faces": [
                {**asdict(face), "key_frames": raw["key_frames"]}
                for face, raw in zip(self.faces, self.manifest["faces"], strict=True)
            ],
        }

    def _chunk(self, entry: str, name: str, rows: int) -> NDArray[Any]:
        with self._lock:
            values = self._cache.pop(entry, None)
            if values is None:
                while len(self._cache) >= _CACHED_CHUNKS * len(FRAME_ARRAYS) * self._most_at_once:
                    self._cache.pop(next(iter(self._cache)))
                values = self._decoded(entry, name, rows)
            self._cache[entry] = values  # the last to go
            return values

    def _decoded(self, entry: str, name: str, rows: int) -> NDArray[Any]:
        values = decode(name, self._array(entry, lambda stored: check_chunk(name, stored, rows)))
        try:
            if name in PLACES:
                Reach.of(name, values).check(max(self.media.width, self.media.height))
        except ValueError as error:
            raise AssetError(f"entry {entry} of {self.path.name} cannot be used ({error})") from None
        return values

    def _array(self, name: str, check: Callable[[NDArray[Any]], None] = lambda _: None) -> NDArray[Any]:
        if name not in self._entries:
            raise AssetError(f"{self.path.name} has no entry {name}")
        try:
            limit = entry_limit(name)
        except ValueError as error:
            raise AssetError(f"{self.path.name} cannot be used: {error}") from None
        data = self._read(name, self._entries[name], limit)
        try:
            array = from_bytes(data)
            check(array)
            return array
        except (ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, RecursionError) as error:
            raise AssetError(f"entry {name} of {self.path.name} is not an array ({error})") from None

    def _read(self, name: str, digest: str, limit: int) -> bytes:
        self._check_open()
        try:
            data = self._file.read(name, limit)
        except DAMAGE as error:
            raise AssetError(f"entry {name} of {self.path.name} is missing or damaged ({error})") from None
        if hashlib.sha256(data).hexdigest() != digest:
            raise AssetError(f"entry {name} of {self.path.name} was altered")
        return data

    def _check_open(self) -> None:
        if self._file.closed:
            raise AssetError(f"{self.path.name} has been closed: use it before that, within its `with` block")


def _remove(path: Path, made_by: int) -> None:
    """Remove a temporary asset, if this is the process that made it."""
    if os.getpid() == made_by:
        path.unlink(missing_ok=True)


def open_asset(
    path: str | Path,
    source: str | Path | None = None,
    *,
    find_source: bool = True,
    limits: MediaLimits | None = None,
) -> VectorVideo:
    """Open an asset file; `source` is the clip it was made from, needed to render it.

    Without a source it is looked for where the asset notes it, relative to itself, and beside it; find_source=False
    leaves that out, as it should be for assets from others in a service. Either way the clip must have the noted
    sha256 before a frame of it is read.  limits: what the clip must keep when it is read, those that it was vectorised
    with if they were not the usual ones. Raises `AssetError` when the file is truncated, altered, of another version or
    without a face.
    """
    video = VectorVideo(path, source, limits=limits)
    if source is None and find_source:
        video.source = found_source(video.path, video.manifest)
    return video


def check_vectorized(*videos: object) -> None:
    """Raise `ValueError` for whatever else, such as a path, is in the place of a vectorised clip or picture."""
    for video in videos:
        if not isinstance(video, VectorVideo):
            what = f"{video!r} is nothing that was vectorised"
            if isinstance(video, (str, os.PathLike)):
                what = f"{os.fspath(video)!r} is a path"
            raise ValueError(f"{what}: give what pvg.vectorize or pvg.open_asset returns for it")


def faces_by_index(video: VectorVideo, faces: str | Sequence[int], *, what: str = "clip") -> tuple[int, ...]:
    """The face numbers that `faces` ("all" or indices) selects. Raises `ValueError` on an unknown one.

    what: the video is called in the message.
    """
    known = tuple(face.index for face in video.faces)
    if isinstance(faces, str) and faces == "all":
        return known
    if isinstance(faces, str) or not isinstance(faces, Iterable):
        raise ValueError(f'faces must be "all" or a sequence of face numbers, not {faces!r}')
    chosen = tuple(whole_number("each of faces", face, low=None) for face in faces)
    unknown = [face for face in chosen if face not in known]
    if unknown:
        has = "face 0 only" if len(known) == 1 else f"faces 0 to {len(known) - 1}"
        raise ValueError(f"no face {unknown[0]}; this {what} has {has}")
    return chosen
