"""The clips measured on: 1080p, played there and back to any length, cropped, scaled and padded to any size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.quality.media import MEDIA, find_material
from pvg.video import Frame, MediaInfo, VideoWriter, probe, read_frames

_FULL_HD_CLIP = "man_stubble_warm_kitchen_audio_1080x1920.mp4"
_FULL_HD = (1920, 1080)
_CHUNK = 25
_CRF = 14  # clips made here keep what makes the source costly to code
Change = Callable[[Frame], Frame]


@dataclass(frozen=True)
class Window:
    """A part of a picture drawn at another size: centre in source pixels, size drawn, and scale (drawn / source)."""

    x: float
    y: float
    width: int
    height: int
    scale: float

    def draw(self, frame: Frame) -> Frame:
        """The window of a frame; beyond the picture its edge is repeated."""
        planes = []
        for p, plane in enumerate(frame.planes):
            dx, dy = frame.format.chroma_log2 if p else (0, 0)
            size = (self.width >> dx, self.height >> dy)
            planes.append(self._plane(plane, (self.x / 2**dx, self.y / 2**dy), size))
        return replace(frame, planes=(planes[0], planes[1], planes[2]))

    def _plane(self, plane: NDArray[Any], center: tuple[float, float], size: tuple[int, int]) -> NDArray[Any]:
        w, h = (max(1, round(n / self.scale)) for n in size)
        left, top = round(center[0] - w / 2), round(center[1] - h / 2)
        right, bottom = left + w, top + h
        rows, columns = plane.shape
        part = plane[max(0, top) : min(rows, bottom), max(0, left) : min(columns, right)]
        borders = (max(0, -top), max(0, bottom - rows), max(0, -left), max(0, right - columns))
        framed = cv2.copyMakeBorder(part, *borders, cv2.BORDER_REPLICATE) if any(borders) else part
        if framed.shape == (size[1], size[0]):
            return np.ascontiguousarray(framed)
        how = cv2.INTER_AREA if self.scale < 1 else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(framed, size, interpolation=how))


def there_and_back(clip: Path, count: int) -> Iterator[Frame]:
    """`count` frames of a clip, played forwards and backwards in turns."""
    length = given = 0
    forwards = True
    while given < count:
        for frame in read_frames(clip) if forwards else _backwards(clip, length):
            length = max(length, frame.index + 1)
            yield frame
            given += 1
            if given == count:
                return
        forwards = not forwards


def _backwards(clip: Path, length: int) -> Iterator[Frame]:
    for stop in range(length, 0, -_CHUNK):
        yield from reversed(list(read_frames(clip, start=max(0, stop - _CHUNK), stop=stop)))


def write_clip(target: Path, frames: Iterable[Frame], info: MediaInfo) -> Path:
    """Write frames one after the other at the clip's rate, without sound; `info` is that of their source."""
    if info.time_base is None:
        raise ValueError("a clip is wanted, not a picture")
    step = max(1, round(1 / ((info.frame_rate or Fraction(25)) * info.time_base)))
    source = iter(frames)
    first = next(source)
    facts = replace(info, width=first.width, height=first.height, has_audio=False, audio_codec=None)
    with VideoWriter(target, facts, first.format, crf=_CRF) as writer:
        for index, frame in enumerate(chain([first], source)):
            stamp = index * step
            writer.write(replace(frame, index=index, pts=stamp, time_s=float(stamp * info.time_base), duration=step))
    return target


def encode(target: Path, info: MediaInfo, frames: Sequence[Frame], count: int, **options: Any) -> None:
    """Write `count` frames, the given ones there and back, with the writer's own settings or `options`."""
    assert info.time_base is not None
    step = max(1, round(1 / ((info.frame_rate or Fraction(25)) * info.time_base)))
    round_trip = [*frames, *frames[-2:0:-1]]
    with VideoWriter(target, info, info.format, **options) as writer:
        for index in range(count):
            frame = round_trip[index % len(round_trip)]
            writer.write(replace(frame, index=index, pts=index * step, duration=step))


def make_clip(source: Path, target: Path, count: int, window: Window | None = None) -> Path:
    """`count` frames of `source` there and back, through a window."""
    frames = there_and_back(source, count)
    return write_clip(target, frames if window is None else map(window.draw, frames), probe(source))


@dataclass(frozen=True)
class Material:
    """clip: what is measured on, 1080p unless the user named another;  portraits: references."""

    clip: Path
    portraits: tuple[Path, ...]
    source: str


def find_clip(named: Path | None, folder: Path) -> Material:
    """The named clip, else the 1080p clip of the media folder, else the registry's sample scaled up to 1080p."""
    material = find_material()
    if named is not None:
        return Material(named, material.references, "given")
    if (MEDIA / "clips" / _FULL_HD_CLIP).is_file():
        return Material(MEDIA / "clips" / _FULL_HD_CLIP, material.references, material.source)
    sample = material.clips[0]
    info = probe(sample)
    scale = _FULL_HD[1] / info.height
    window = Window((info.width - 1) / 2, (info.height - 1) / 2, *_FULL_HD, scale)
    target = folder / f"{sample.stem}_scaled_to_1080p.mp4"
    return Material(make_clip(sample, target, info.frame_count, window), material.references, material.source)
