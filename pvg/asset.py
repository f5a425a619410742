"""A vectorised clip on disk: one zip file of a JSON manifest and plain arrays, read by frame range.

The manifest lists the sha256 of every entry and the archive's comment holds the manifest's own, so an altered byte
is refused when it is read and a truncated file when it is opened. Arrays are .npy and loaded without pickle: opening
an asset never executes anything. Positions are kept as fixed-point steps from frame to frame and mattes as bytes,
both deflated, in chunks of `CHUNK_FRAMES`. The source clip stays beside the asset: it is the store of the Poisson
regions, since f_i is the Laplacian of the clip itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import lzma
import os
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pvg.curves import Floats, boundary_points
from pvg.errors import AssetError
from pvg.video import MediaInfo, sha256_file

FORMAT_VERSION = 1
CHUNK_FRAMES = 32
_POINT_SCALE = 32  # positions are stored in 1/32 px
_RADIUS_SCALE = 8
_MATTE_LEVELS = 63  # 64 levels of opacity: one step of a correction of 70 levels is about one level
_CACHED_CHUNKS = 4
# what zipfile and its decompressors raise on damaged bytes
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    KeyError,
    ValueError,
    RuntimeError,
    OverflowError,
    OSError,
    EOFError,
)


@dataclass(frozen=True)
class MediaSummary:
    """What the source is, as shown to people; see `pvg.video.MediaInfo` for all a file says of itself.

    kind: "video" or "image";  width, height: upright pixels;  frame_rate: average, frames a second, None for images;
    rotation: clockwise degrees that made the stored picture upright.
    """

    kind: str
    width: int
    height: int
    frame_rate: float | None
    frame_count: int
    duration_s: float
    codec: str
    pixel_format: str
    has_audio: bool
    rotation: int

    @classmethod
    def of(cls, media: MediaInfo, frame_count: int) -> MediaSummary:
        """The summary of a file of which `frame_count` frames were read."""
        return cls(
            kind=media.kind,
            width=media.width,
            height=media.height,
            frame_rate=None if media.frame_rate is None else round(float(media.frame_rate), 3),
            frame_count=frame_count,
            duration_s=round(media.duration_s, 3),
            codec=media.codec,
            pixel_format=media.pixel_format,
            has_audio=media.has_audio,
            rotation=media.rotation,
        )


@dataclass(frozen=True)
class FaceSummary:
    """One tracked face of a clip, as shown to people.

    width_px: median jaw width;  skin_rgb: median colour of its skin curves in the key frame, 0-255;
    person: who it is, as far as can be told; faces of one person are never seen at the same time.
    """

    index: int
    first_frame: int
    last_frame: int
    width_px: float
    skin_rgb: tuple[int, int, int]
    person: int
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """The boundary colours of one key frame: eq. (3) solved there.

    frame: frame number in the clip;  colors: (S, 3) float32 g, 0-255 RGB, on the table's labels;
    visible: (S,) bool, whether the sample lay on visible skin or a visible feature;
    skin: (N, 3) float32, colours of the open skin evenly over the face, N = 0 when there is too little of it.
    """

    frame: int
    colors: Floats
    visible: NDArray[np.bool_]
    skin: Floats


@dataclass(frozen=True, eq=False)
class FaceFrameData:
    """The geometry of one face in one frame.

    points: (106, 2) landmarks;  skin_points: (88, 2);  boundary: (192, 2) mask boundary samples, source pixels;
    score: face score in [0, 1], 0 where the face is not seen;  pose: (3,) yaw, pitch, roll in degrees;
    box: (4,) x0, y0, x1, y1 of the region in source pixels (may reach over the picture's edge);
    matte: (h, w) uint8, the soft matte over the box, 255 = skin.
    """

    points: Floats
    skin_points: Floats
    boundary: Floats
    score: float
    pose: Floats
    box: Floats
    matte: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class FaceRecord:
    """A face of the clip: what it is, and its key frames."""

    summary: FaceSummary
    key_frames: tuple[KeyFrame, ...]

    def key_frame_of(self, frame: int) -> KeyFrame:
        """The key frame whose colours serve `frame`: the last one at or before it, else the first."""
        earlier = [key for key in self.key_frames if key.frame <= frame]
        return earlier[-1] if earlier else self.key_frames[0]


_FRAME_ARRAYS = ("points", "skin_points", "radius", "score", "pose", "box", "matte")
_FIXED_POINT = {"points": _POINT_SCALE, "skin_points": _POINT_SCALE, "radius": _RADIUS_SCALE, "box": _RADIUS_SCALE}


def _encode(name: str, values: NDArray[Any]) -> NDArray[Any]:
    if name == "matte":
        return np.rint(values * (_MATTE_LEVELS / 255.0)).astype(np.uint8)
    if name not in _FIXED_POINT:
        return values
    fixed = np.rint(values * _FIXED_POINT[name]).astype(np.int32)
    return np.diff(fixed, axis=0, prepend=np.zeros_like(fixed[:1]))


def _decode(name: str, values: NDArray[Any]) -> NDArray[Any]:
    if name == "matte":
        return np.rint(values * (255.0 / _MATTE_LEVELS)).astype(np.uint8)
    if name not in _FIXED_POINT:
        return values
    return (np.cumsum(values, axis=0, dtype=np.int64) / _FIXED_POINT[name]).astype(np.float32)


def _planes_of_bytes(array: NDArray[Any]) -> NDArray[np.uint8]:
    """The bytes of `array` grouped by significance: steps are small, so their high bytes deflate to nothing."""
    flat = np.ascontiguousarray(array).view(np.uint8).reshape(-1, array.itemsize)
    return np.ascontiguousarray(flat.T)


def _npy(array: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


class AssetWriter:
    """Write an asset chunk by chunk; `finish` publishes it under its name, leaving without it removes it."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        handle, name = tempfile.mkstemp(prefix=f".{self.path.name}.", dir=self.path.parent)
        os.close(handle)
        self._temporary = Path(name)
        self._zip = zipfile.ZipFile(self._temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=6)
        self._entries: dict[str, str] = {}
        self._pending: dict[int, dict[str, list[NDArray[Any]]]] = {}
        self._chunks: dict[int, int] = {}
        self._faces: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()
        self._temporary.unlink(missing_ok=True)

    def add_frame(self, face: int, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Append one frame of a face: points, skin_points, radius, score, pose, box, matte."""
        pending = self._pending.setdefault(face, {name: [] for name in _FRAME_ARRAYS})
        for name in _FRAME_ARRAYS:
            pending[name].append(arrays[name])
        if len(pending["score"]) == CHUNK_FRAMES:
            self._flush(face)

    def add_face(self, record: FaceRecord) -> None:
        """Close a face: flush its frames and write its key frames."""
        face = record.summary.index
        if self._pending.get(face, {}).get("score"):
            self._flush(face)
        self._array(f"face{face}/colors", np.stack([key.colors for key in record.key_frames]))
        self._array(f"face{face}/visible", np.stack([key.visible for key in record.key_frames]))
        for k, key in enumerate(record.key_frames):
            self._array(f"face{face}/skin/{k:06d}", key.skin)
        self._faces.append({**asdict(record.summary), "key_frames": [key.frame for key in record.key_frames]})

    def finish(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest and move the file to its name."""
        body = {"format": FORMAT_VERSION, **manifest, "faces": self._faces, "entries": self._entries}
        data = json.dumps(body, indent=1).encode()
        self._zip.writestr("manifest.json", data)
        self._zip.comment = hashlib.sha256(data).hexdigest().encode()
        self._zip.close()
        self._temporary.chmod(0o644)
        self._temporary.replace(self.path)

    def _flush(self, face: int) -> None:
        chunk = self._chunks.get(face, 0)
        for name, rows in self._pending[face].items():
            values = _encode(name, np.stack(rows))
            self._array(f"face{face}/{name}/{chunk:06d}", values)
            rows.clear()
        self._chunks[face] = chunk + 1

    def _array(self, name: str, array: NDArray[Any]) -> None:
        header = {"dtype": array.dtype.str, "shape": array.shape}
        data = json.dumps(header).encode() + b"\n" + _npy(_planes_of_bytes(array))
        self._zip.writestr(name, data)
        self._entries[name] = hashlib.sha256(data).hexdigest()


def _face_from_json(values: Mapping[str, Any]) -> FaceSummary:
    known = {field.name: values[field.name] for field in fields(FaceSummary)}
    known["skin_rgb"], known["warnings"] = tuple(known["skin_rgb"]), tuple(known["warnings"])
    return FaceSummary(**known)


class VectorVideo:
    """A vectorised clip or image: its geometry, boundary colours and mattes, open for reading by frame.

    Made by `pvg.vectorize` and `pvg.open_asset`. A context manager; closing it removes a temporary asset.
    """

    def __init__(self, path: str | Path, source: str | Path | None = None, *, temporary: bool = False) -> None:
        self.path = Path(path)
        self.source = None if source is None else Path(source)
        self._temporary = temporary
        self._cache: dict[str, NDArray[Any]] = {}
        try:
            self._zip = zipfile.ZipFile(self.path)
        except FileNotFoundError:
            raise AssetError(f"no asset file at {self.path}") from None
        except _DAMAGE as error:
            raise AssetError(f"{self.path.name} is not an asset or is truncated ({error})") from None
        try:
            self._read_manifest()
        except BaseException:
            self._zip.close()
            raise

    def _read_manifest(self) -> None:
        data = self._read("manifest.json", self._zip.comment.decode("ascii", "replace"))
        try:
            manifest = json.loads(data)
            version = manifest["format"]
            if version != FORMAT_VERSION:
                raise AssetError(
                    f"{self.path.name} has asset format {version}, this library reads {FORMAT_VERSION}; "
                    "vectorise the clip again"
                )
            self.manifest: dict[str, Any] = manifest
            self._entries: dict[str, str] = manifest["entries"]
            self.media = MediaSummary(**manifest["media"])
            self.source_sha256: str = manifest["source_sha256"]
            self.settings: dict[str, Any] = manifest["settings"]
            self.shots: tuple[int, ...] = tuple(manifest["shots"])
            self.faces: tuple[FaceSummary, ...] = tuple(_face_from_json(face) for face in manifest["faces"])
        except (KeyError, TypeError, ValueError) as error:
            raise AssetError(f"the manifest of {self.path.name} is malformed ({error!r})") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        with contextlib.suppress(AttributeError):  # a constructor that raised has nothing to close
            self.close()

    def close(self) -> None:
        """Close the file; a temporary asset is removed. Twice is harmless."""
        self._zip.close()
        if self._temporary:
            self.path.unlink(missing_ok=True)

    def save(self, path: str | Path) -> None:
        """Copy the asset file to `path`, appearing there only when complete."""
        target = Path(path)
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
        with os.fdopen(handle, "wb") as out, self.path.open("rb") as data:
            while block := data.read(1 << 20):
                out.write(block)
        Path(name).chmod(0o644)
        Path(name).replace(target)

    @property
    def frame_count(self) -> int:
        """Number of frames of the clip, counted while vectorising."""
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
        for face, raw in zip(self.faces, self.manifest["faces"], strict=True):
            colors = self._array(f"face{face.index}/colors")
            visible = self._array(f"face{face.index}/visible")
            keys = zip(raw["key_frames"], colors, visible, strict=True)
            frames = tuple(
                KeyFrame(int(f), c, v, self._array(f"face{face.index}/skin/{k:06d}"))
                for k, (f, c, v) in enumerate(keys)
            )
            out.append(FaceRecord(face, frames))
        return tuple(out)

    def face_frame(self, face: int, frame: int) -> FaceFrameData | None:
        """Geometry of `face` in `frame`, None outside its track. Raises `AssetError` when altered."""
        summary = self.faces[face]
        if not summary.first_frame <= frame <= summary.last_frame:
            return None
        chunk, row = divmod(frame - summary.first_frame, CHUNK_FRAMES)
        part = {name: self._chunk(f"face{face}/{name}/{chunk:06d}", name)[row] for name in _FRAME_ARRAYS}
        return FaceFrameData(
            points=part["points"],
            skin_points=part["skin_points"],
            boundary=boundary_points(part["radius"], part["points"]),
            score=float(part["score"][0]),
            pose=part["pose"],
            box=part["box"],
            matte=part["matte"],
        )

    def landmarks(self, face: int) -> Floats:
        """(frames of the track, 106, 2) float32 landmarks in source pixels."""
        summary = self.faces[face]
        chunks = -(-(summary.last_frame - summary.first_frame + 1) // CHUNK_FRAMES)
        parts = [_decode("points", self._array(f"face{face}/points/{c:06d}")) for c in range(chunks)]
        return np.concatenate(parts).astype(np.float32)

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

    _source_checked = False

    def verify(self) -> None:
        """Read every entry and check its digest. Raises `AssetError`."""
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

    def _chunk(self, entry: str, name: str) -> NDArray[Any]:
        if entry not in self._cache:
            limit = _CACHED_CHUNKS * len(_FRAME_ARRAYS) * max(1, len(self.faces))
            while len(self._cache) >= limit:
                self._cache.pop(next(iter(self._cache)))
            self._cache[entry] = _decode(name, self._array(entry))
        return self._cache[entry]

    def _array(self, name: str) -> NDArray[Any]:
        if name not in self._entries:
            raise AssetError(f"{self.path.name} has no entry {name}")
        data = self._read(name, self._entries[name])
        try:
            head, _, body = data.partition(b"\n")
            header = json.loads(head)
            raw = np.load(io.BytesIO(body), allow_pickle=False)
            array: NDArray[Any] = np.ascontiguousarray(raw.T).view(np.dtype(header["dtype"])).reshape(header["shape"])
        except (ValueError, TypeError, KeyError, EOFError) as error:
            raise AssetError(f"entry {name} of {self.path.name} is not an array ({error})") from None
        return array

    def _read(self, name: str, digest: str) -> bytes:
        try:
            data = self._zip.read(name)
        except _DAMAGE as error:
            raise AssetError(f"entry {name} of {self.path.name} is missing or damaged ({error})") from None
        if hashlib.sha256(data).hexdigest() != digest:
            raise AssetError(f"entry {name} of {self.path.name} was altered")
        return data


def open_asset(path: str | Path, source: str | Path | None = None) -> VectorVideo:
    """Open an asset file; `source` is the clip it was made from, needed to render it.

    Raises `AssetError` when the file is truncated, altered or of another version.
    """
    return VectorVideo(path, source)


def faces_by_index(video: VectorVideo, faces: str | Sequence[int]) -> tuple[int, ...]:
    """The face numbers that `faces` ("all" or indices) selects. Raises `ValueError` on an unknown one."""
    known = tuple(face.index for face in video.faces)
    if faces == "all":
        return known
    chosen = tuple(int(face) for face in faces)
    unknown = [face for face in chosen if face not in known]
    if unknown:
        raise ValueError(f"no face {unknown[0]}; this clip has faces 0 to {len(known) - 1}")
    return chosen
