"""What an asset may say: its manifest's values and its arrays' shapes, checked before anything is made of them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray

from pvg.asset.arrays import CHUNK_FRAMES, FRAME_ARRAYS, MATTES
from pvg.curves import BOUNDARY_SAMPLES, Matching, table_labels
from pvg.face import PARTS, layout
from pvg.haze import MOST_HAZE
from pvg.skin import MaskMethod
from pvg.video import INPUT_COLORS
from pvg.warmth import MOST_WARMTH

_MAX_SIDE: Final = 65_535
_MAX_FRAMES: Final = 10**8
#: cells of a matte, which is of reduced size; its longer side has some hundreds
_MAX_CELLS: Final = 1024**2
#: of the picture's longer side, over its edge: what is stored of a face that leaves or overfills the picture stays near
_FARTHEST: Final = 8.0
#: of the frames' arrays, those of places and lengths in pixels
PLACES: Final = frozenset({"points", "skin_points", "radius", "box"})
_SKIN_COLORS: Final = 65_536
#: key frames of one face: one in 20 frames of the longest clip
_MAX_KEYS: Final = 10_000
#: number of a track, which only names its entries: every one that was found has one, also those that are no face
_MAX_TRACK: Final = 10**9
#: of the line of type and shape, and the array's own header
_HEAD_BYTES: Final = 1024

#: dtype and shape of each array of the frames, without its first axis; None is any number of cells
_OF_FRAMES: Final[dict[str, tuple[str, tuple[int | None, ...]]]] = {
    "points": ("<i4", (layout.LANDMARK_COUNT, 2)),
    "skin_points": ("<i4", (layout.SKIN_COUNT, 2)),
    "radius": ("<i4", (BOUNDARY_SAMPLES,)),
    "score": ("<f4", (1,)),
    "pose": ("<f4", (3,)),
    "box": ("<i4", (4,)),
    "matte": ("|u1", (None, None)),
    "body": ("|u1", (None, None)),
}
_OF_KEYS: Final[dict[str, tuple[str, tuple[int | None, ...]]]] = {
    "colors": ("<f4", (None, 3)),
    "visible": ("|b1", (None,)),
    "parts": ("<f4", (len(PARTS), 3)),
    "skin": ("<f4", (3,)),
    "skin_at": ("<i2", ()),
}
_SETTINGS: Final[dict[str, tuple[Any, ...]]] = {
    "mask": get_args(MaskMethod),
    "matching": get_args(Matching),
    "reference": (True, False),
}
_MAY_BE_NAN: Final = frozenset({"parts"})


def entry_limit(name: str) -> int:
    """The most bytes that the entry of this name inflates to. Raises `ValueError` for one that assets do not have."""
    parts = name.split("/")
    kind = parts[1] if len(parts) > 1 else ""
    if kind in MATTES:
        return _HEAD_BYTES + CHUNK_FRAMES * _MAX_CELLS
    if kind in _OF_FRAMES:
        dtype, shape = _OF_FRAMES[kind]
        return _HEAD_BYTES + CHUNK_FRAMES * np.dtype(dtype).itemsize * math.prod(side or 1 for side in shape)
    if kind in {"skin", "skin_at"}:
        return _HEAD_BYTES + _SKIN_COLORS * 12
    if kind in _OF_KEYS:
        return _HEAD_BYTES + _MAX_KEYS * len(table_labels()) * 12
    raise ValueError(f"an asset has no entry {name}")


def check_chunk(name: str, stored: NDArray[Any], rows: int) -> None:
    """Raise `ValueError` when the stored chunk of a frame array has not so many rows of its shape."""
    dtype, shape = _OF_FRAMES[name]
    _check(stored, dtype, (rows, *shape))
    if name in MATTES and not 0 < stored.shape[1] * stored.shape[2] <= _MAX_CELLS:
        raise ValueError(f"it has {stored.shape[1]} x {stored.shape[2]} cells")
    _check_finite(name, stored)


@dataclass(frozen=True)
class Reach:
    """How far the values of an array of `PLACES` reach, source pixels.

    least, greatest: of all of them;  shortest: of the sides of boxes, infinite of what are none.
    """

    least: float
    greatest: float
    shortest: float

    @classmethod
    def of(cls, name: str, values: NDArray[Any]) -> Reach:
        """That of an array (n, …) of this name, n ≥ 1."""
        shortest = float((values[:, 2:] - values[:, :2]).min()) if name == "box" else math.inf
        return cls(float(values.min()), float(values.max()), shortest)

    def joined(self, other: Reach) -> Reach:
        """That of two arrays of one name."""
        least, shortest = min(self.least, other.least), min(self.shortest, other.shortest)
        return Reach(least, max(self.greatest, other.greatest), shortest)

    def check(self, side: int) -> None:
        """Raise `ValueError` where it is far from a picture whose longer side has `side` pixels, or a box has none."""
        if not -_FARTHEST * side <= self.least <= self.greatest <= (1 + _FARTHEST) * side:
            raise ValueError("its values are far from the picture")
        if self.shortest < 1:
            raise ValueError("its boxes have no pixel")


def check_keys(name: str, array: NDArray[Any], count: int) -> None:
    """Raise `ValueError` when an array of key frames, or of the skin colours of one, has not `count` rows."""
    dtype, shape = _OF_KEYS[name]
    labels = (len(table_labels()), *shape[1:]) if name in {"colors", "visible"} else shape
    _check(array, dtype, (count, *labels))
    if name == "skin_at" and array.size and not 0 <= array.min() <= array.max() < len(table_labels()):
        raise ValueError("it names samples that there are not")
    _check_finite(name, array)


def _check(array: NDArray[Any], dtype: str, shape: Sequence[int | None]) -> None:
    fits = len(array.shape) == len(shape) and all(
        want is None or have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if array.dtype.str != dtype or not fits:
        raise ValueError(f"it is {array.dtype.str} {array.shape}, not {dtype} {tuple(shape)}")


def _check_finite(name: str, array: NDArray[Any]) -> None:
    if array.dtype.kind != "f":
        return
    bad = np.isinf(array) if name in _MAY_BE_NAN else ~np.isfinite(array)
    if bad.any():
        raise ValueError("it has values that are no numbers")


def check_manifest(manifest: Mapping[str, Any]) -> None:
    """Raise `ValueError`, `TypeError` or `KeyError` for values that no asset has."""
    entries, media = manifest["entries"], manifest["media"]
    if not all(type(one) is str for pair in entries.items() for one in pair):
        raise ValueError("its entries have no digests")
    for side in ("width", "height"):
        _whole(media[side], 1, _MAX_SIDE, side)
    frames = _whole(media["frame_count"], 1, _MAX_FRAMES, "frame_count")
    _number(media["duration_s"], "duration_s")
    if media["frame_rate"] is not None:
        _number(media["frame_rate"], "frame_rate")
    for name in ("kind", "codec", "pixel_format"):
        _text(media[name], name)
    _text(manifest["source_sha256"], "source_sha256")
    _check_settings(manifest["settings"])
    _ascending(manifest["shots"], frames, "shots")
    if not manifest["faces"]:
        raise ValueError("it has no face")
    for index, face in enumerate(manifest["faces"]):
        _check_face(face, index, frames, len(entries))


def _check_settings(settings: Mapping[str, Any]) -> None:
    for name, known in _SETTINGS.items():
        if settings[name] not in known:
            raise ValueError(f"its {name} is not known")
    if settings.get("input_color", "auto") not in INPUT_COLORS:
        raise ValueError("its input_color is not known")


def _check_face(face: Mapping[str, Any], index: int, frames: int, entries: int) -> None:
    _whole(face["index"], index, index, "index of a face")
    first = _whole(face["first_frame"], 0, frames - 1, "first_frame")
    last = _whole(face["last_frame"], first, frames - 1, "last_frame")
    if -(-(last - first + 1) // CHUNK_FRAMES) * len(FRAME_ARRAYS) > entries:
        raise ValueError(f"face {index} has more frames than there is room for")
    _whole(face["track"], 0, _MAX_TRACK, "track")
    _whole(face["person"], 0, entries, "person")
    _whole(face.get("haze", 0), 0, MOST_HAZE, "haze")
    _whole(face.get("warmth", 0), 0, MOST_WARMTH, "warmth")
    _number(face["width_px"], "width_px")
    if len([_whole(one, 0, 255, "skin_rgb") for one in face["skin_rgb"]]) != 3:
        raise ValueError("skin_rgb is no colour")
    for line in face["warnings"]:
        _text(line, "warning")
    keys = face["key_frames"]
    _ascending(keys, frames, "key_frames")
    if not 0 < len(keys) <= min(_MAX_KEYS, entries) or len(face["key_frames_since"]) != len(keys):
        raise ValueError(f"face {index} has no key frames, or more than there is room for")
    for one in face["key_frames_since"]:
        if one is not None:
            _whole(one, 0, frames - 1, "key_frames_since")


def _whole(value: object, low: int, high: int, name: str) -> int:
    if type(value) is not int or not low <= value <= high:
        raise ValueError(f"{name} is not a whole number from {low} to {high}")
    return value


def _number(value: object, name: str) -> None:
    if type(value) not in {int, float} or not 0 <= float(value) < 1e9:  # type: ignore[arg-type]
        raise ValueError(f"{name} is not a number that it may be")


def _text(value: object, name: str) -> None:
    if type(value) is not str:
        raise ValueError(f"{name} is no text")


def _ascending(values: object, end: int, name: str) -> None:
    if not isinstance(values, list):
        raise ValueError(f"{name} is no list")
    for value in values:
        _whole(value, 0, end - 1, name)
    if any(a >= b for a, b in itertools.pairwise(values)):
        raise ValueError(f"{name} do not ascend")
