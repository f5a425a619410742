"""Algorithm 1, rendering: a vectorised clip and its looks give clips, or single frames.

With f_i the Laplacian of the clip itself, eq. (1) for new boundary colours g' and a coefficient lambda reads

    u' = lambda I + H(g' - lambda g),     H: harmonic extension from the curves.

It is affine in every pixel, so it is applied to the planes the clip is coded in: a smooth membrane is added under the
soft matte, texture is never resampled, and what lies outside the matte keeps its bits. All looks share one operator.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg.asset import VectorVideo
from pvg.curves import CurveLabels, Floats, face_frame, labels_by_length, stack_points, table_labels
from pvg.errors import AssetError
from pvg.looks import Look, transfer
from pvg.matching import Chain
from pvg.poisson import Membrane
from pvg.region import Region, divide_overlaps, open_region
from pvg.video import Frame, MediaInfo, PixelFormat, VideoWriter, probe, read_frames, write_image

Progress = Callable[[str, int, int], None]
Planes = tuple[NDArray[Any], ...]

_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
_AUTO_EXPONENT = 0.6  # METHOD 7b: 0.5 to 0.75 keeps eyes and brows crisp, 1 looks harsh
_AUTO_RANGE = (0.5, 2.0)
_CHAIN_SPACING_PX = 2.0
_EYES = ((52, 53, 72, 54, 55, 56, 73, 57), (58, 59, 75, 60, 61, 62, 76, 63))
_INNER_LIPS = tuple(range(96, 104))
_FEATHER = 0.012  # of the face's width


def _feathered(region: Region, polygons: Sequence[Floats], width: float) -> Floats:
    """(h, w) float32 in [0, 1]: 1 inside the polygons (source pixels), falling off over `_FEATHER` of `width`."""
    guard = np.zeros(region.alpha.shape, np.float32)
    origin = np.array([region.x, region.y], np.float32)
    for polygon in polygons:  # 1/16 pixel positions, so that the guard does not jump as the face moves
        corners = np.rint((polygon - origin) * 16).astype(np.int32)
        cv2.fillPoly(guard, [corners], 1.0, lineType=cv2.LINE_AA, shift=4)
    sigma = max(0.8, _FEATHER * width)
    return np.asarray(cv2.GaussianBlur(guard, (0, 0), sigma), np.float32)


def protected_alpha(region: Region, protect: Sequence[str]) -> Floats:
    """The region's matte without the features that keep their own colour ("eyes", "teeth")."""
    points = region.data.points
    polygons: list[Floats] = []
    if "eyes" in protect:
        polygons += [points[list(eye)] for eye in _EYES]
    if "teeth" in protect:
        polygons.append(points[list(_INNER_LIPS)])
    if not polygons:
        return region.alpha
    guard = _feathered(region, polygons, face_frame(points).width)
    guarded: Floats = region.alpha * (1.0 - guard)
    return guarded


def _contrast_at_curves(look: Look, g: Floats, new: Floats) -> Floats | float:
    """Lambda of a look: a number, or (S, 1) values at the curves that follow the brightness asked for."""
    if look.contrast != "auto":
        return 1.0 + look.strength * (look.contrast - 1.0)
    ratio = (new @ _LUMA + 1.0) / (g @ _LUMA + 1.0)
    field: Floats = np.clip(ratio**_AUTO_EXPONENT, *_AUTO_RANGE)[:, None].astype(np.float32)
    return field


def _add(
    planes: list[NDArray[Any]], source: Planes, region: Region, membrane: Membrane, alpha: Floats, change: _Change
) -> None:
    """Apply one look to one region of the planes, in place: P += alpha ((lambda - 1)(I - black - mean HF) + H).

    source: the planes I of the frame as it came, where `planes` may hold another face already. With a lambda other
    than 1, channels 0 to 2 of the membrane are H(g).
    """
    pixel_format = change.format
    sx, sy = pixel_format.chroma_log2
    h, w = alpha.shape
    top = 2**pixel_format.depth - 1
    for p, (plane, before) in enumerate(zip(planes, source, strict=True)):
        dx, dy = (sx, sy) if p else (0, 0)
        rows, columns = -(-h // 2**dy), -(-w // 2**dx)
        y, x = region.y >> dy, region.x >> dx
        window = (slice(y, y + rows), slice(x, x + columns))
        part = plane[window]
        weight = alpha if (dx, dy) == (0, 0) else cv2.resize(alpha, (columns, rows), interpolation=cv2.INTER_AREA)
        # chroma sits on the left luma column of its pair and between its rows (the default of H.264 and HEVC)
        xs = region.x + np.arange(columns, dtype=np.float32) * 2**dx
        ys = region.y + np.arange(rows, dtype=np.float32) * 2**dy + (2**dy - 1) / 2
        shift = membrane.read(xs, ys, [change.channel + p])[0]
        if change.contrast_channel is not None:
            gain = membrane.read(xs, ys, [change.contrast_channel])[0] - 1.0
            shift += gain * (before[window] - np.float32(pixel_format.offset[p]))
        elif change.contrast != 1.0:
            # open skin is brighter than the curves around it, so HF has a mean; lambda leaves it where it is
            level = before[window] - np.float32(pixel_format.offset[p])
            high_mean = np.average(level - membrane.read(xs, ys, [p])[0], weights=weight)
            shift += np.float32(change.contrast - 1.0) * (level - np.float32(high_mean))
        shift *= weight
        shift += part
        np.rint(shift, out=shift)
        np.clip(shift, 0, top, out=shift)
        part[:] = shift.astype(part.dtype)


@dataclass(frozen=True)
class _Change:
    """Where a look's right-hand sides stand among the membrane's channels, and its lambda."""

    format: PixelFormat
    channel: int
    contrast: float
    contrast_channel: int | None

    def moved(self, by: int) -> _Change:
        """The same change with its channels elsewhere."""
        there = None if self.contrast_channel is None else self.contrast_channel + by
        return replace(self, channel=self.channel + by, contrast_channel=there)


class _FaceColors:
    """g and every look's g' of one face, frame after frame, by the clip-wide table or the paper's chain."""

    def __init__(self, video: VectorVideo, face: int, looks: Sequence[Look]) -> None:
        record = video.records[face]
        self._keys = record.key_frames
        self._video, self._face = video, face
        self._stacks = [
            np.concatenate([key.colors, *(look.colors[face][k] for look in looks)], axis=1)
            for k, key in enumerate(self._keys)
        ]
        self._record = record
        self._chained = video.settings["matching"] == "chain"
        self._chain: tuple[int, int, Chain, CurveLabels] | None = None  # key, frame, chain, labels

    def at(self, frame: int) -> tuple[CurveLabels, Floats]:
        """Labels and (S, 3 + 3 looks) colours in `frame`."""
        key = self._keys.index(self._record.key_frame_of(frame))
        if not self._chained:
            return table_labels(), self._stacks[key]
        return self._follow(key, frame)

    def _follow(self, key: int, frame: int) -> tuple[CurveLabels, Floats]:
        first = self._keys[key].frame
        if self._chain is None or self._chain[0] != key or self._chain[1] >= frame:
            self._chain = (key, first - 1, Chain(self._stacks[key], table_labels()), table_labels())
        _, last, chain, labels = self._chain
        colors = self._stacks[key]
        for i in range(last + 1, frame + 1):
            data = self._video.face_frame(self._face, i)
            if data is not None:
                points = stack_points(data.points, data.skin_points)
                labels = labels_by_length(points, data.boundary, spacing_px=_CHAIN_SPACING_PX)
                colors = chain.step(labels)
        self._chain = (key, frame, chain, labels)
        return labels, colors


class Renderer:
    """Draws the looks of one clip into its frames; frames may come in any order."""

    def __init__(self, video: VectorVideo, looks: Sequence[Look]) -> None:
        self.video = video
        self.looks = tuple(looks)
        faces = sorted({face for look in looks for face in look.colors})
        # numbers, since one look may be asked for twice
        self._with_face = {face: [i for i, look in enumerate(looks) if face in look.colors] for face in faces}
        self._colors = {
            face: _FaceColors(video, face, [looks[i] for i in which]) for face, which in self._with_face.items()
        }

    def draw(self, frame: Frame) -> list[Frame]:
        """One frame for every look, in their order; untouched planes are shared with `frame`."""
        planes: dict[int, list[NDArray[Any]]] = {}
        for face, region, colors in self._regions(frame):
            if colors is not None:
                self._draw_face(frame, region, self._with_face[face], colors, planes)
        return [
            frame.with_planes((p[0], p[1], p[2])) if (p := planes.get(i)) is not None else frame
            for i in range(len(self.looks))
        ]

    def _regions(self, frame: Frame) -> list[tuple[int, Region, Floats | None]]:
        """(face, region, colours) of every face in the frame; one that no look draws has no colours.

        Those are wanted too: a face before another is not painted with that one's look.
        """
        align = 2 ** max(frame.format.chroma_log2)
        found: list[tuple[int, Region, Floats | None]] = []
        for face in range(len(self.video.faces)) if self._with_face else ():
            data = self.video.face_frame(face, frame.index)
            if data is None:
                continue
            labels, colors = self._colors[face].at(frame.index) if face in self._colors else (table_labels(), None)
            region = open_region(data, labels, frame.width, frame.height, align)
            if region is not None and region.alpha.any():
                found.append((face, region, colors))
        divided = divide_overlaps([region for _, region, _ in found])
        return [(face, region, colors) for (face, _, colors), region in zip(found, divided, strict=True)]

    def _draw_face(
        self,
        frame: Frame,
        region: Region,
        which: list[int],
        colors: Floats,
        planes: dict[int, list[NDArray[Any]]],
    ) -> None:
        g = colors[:, :3]
        to_planes = frame.format.matrix.astype(np.float32).T
        channels: list[Floats] = [g @ to_planes]
        changes: list[_Change] = []
        for k, i in enumerate(which):
            look = self.looks[i]
            new = colors[:, 3 + 3 * k : 6 + 3 * k]
            contrast = _contrast_at_curves(look, g, new)
            start = sum(part.shape[1] for part in channels)
            channels.append((new - contrast * g) @ to_planes)
            if isinstance(contrast, float):
                changes.append(_Change(frame.format, start, contrast, None))
            else:
                channels.append(contrast)
                changes.append(_Change(frame.format, start, 1.0, start + 3))
        if all(change.contrast == 1.0 for change in changes):  # H(g) is not needed
            channels[0] = np.empty((len(g), 0), np.float32)
            changes = [change.moved(-3) for change in changes]
        membrane = region.membrane(np.concatenate(channels, axis=1))
        for i, change in zip(which, changes, strict=True):
            if i not in planes:
                planes[i] = [plane.copy() for plane in frame.planes]
            _add(planes[i], frame.planes, region, membrane, protected_alpha(region, self.looks[i].protect), change)


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")


def render(
    video: VectorVideo,
    looks: Sequence[Look],
    paths: Sequence[str | Path],
    *,
    codec: str = "auto",
    crf: int | None = None,
    preset: str | None = None,
    audio: Literal["copy", "none"] = "copy",
    progress: Progress | None = None,
) -> None:
    """Render every look of `looks` to the path of the same place in `paths`, all in one pass over the clip.

    The container follows from the suffix: .mp4, .mov, .mkv, .webm; .png, .jpg, .webp for an image. codec: "auto",
    "h264", "hevc", "vp9", "av1";  crf, preset: the encoder's own scales;  audio: "copy" or "none".
    progress: called as ("render", frames done, frames); what it raises ends the work and passes through. Files appear
    under their names only when all are complete. Raises `AssetError` when the source clip is missing or another one,
    `MediaError` when it cannot be read, `ValueError` on options that do not fit.
    """
    if len(looks) != len(paths):
        raise ValueError(f"{len(looks)} looks need {len(looks)} paths, not {len(paths)}")
    if not looks:
        return
    targets = [Path(path) for path in paths]
    partials = [_partial(target) for target in targets]
    if len(set(partials)) != len(partials):
        raise ValueError("two looks would be written to the same path")
    source = _drawable_source(video)
    info = probe(source)
    try:
        if info.kind == "image":
            _render_image(video, looks, partials)
        else:
            sound = source if audio == "copy" else None
            options = {"codec": codec, "crf": crf, "preset": preset, "audio_from": sound}
            _render_clip(video, looks, partials, info, options, progress)
        for partial, target in zip(partials, targets, strict=True):
            partial.replace(target)
    finally:
        for partial in partials:
            partial.unlink(missing_ok=True)


def _drawable_source(video: VectorVideo) -> Path:
    if video.settings["reference"] and video.media.kind == "video":
        raise AssetError(
            f"{video.path.name} keeps a reference's key frame only; vectorise the clip in full to render it"
        )
    return video.require_source()


def _render_image(video: VectorVideo, looks: Sequence[Look], paths: list[Path]) -> None:
    (frame,) = read_frames(video.require_source())
    for drawn, path in zip(Renderer(video, looks).draw(frame), paths, strict=True):
        write_image(path, drawn.rgb())


def _render_clip(
    video: VectorVideo,
    looks: Sequence[Look],
    paths: list[Path],
    info: MediaInfo,
    options: dict[str, Any],
    progress: Progress | None,
) -> None:
    renderer = Renderer(video, looks)
    with ExitStack() as stack:
        writers = [stack.enter_context(VideoWriter(path, info, info.format, **options)) for path in paths]
        for frame in read_frames(video.require_source()):
            for writer, drawn in zip(writers, renderer.draw(frame), strict=True):
                writer.write(drawn)
            if progress is not None:
                progress("render", frame.index + 1, video.frame_count)


def source_frame(video: VectorVideo, index: int) -> Frame:
    """Frame `index` of the source clip. Raises `ValueError` when there is none."""
    if not 0 <= index < video.frame_count:
        raise ValueError(f"no frame {index}; the clip has {video.frame_count}")
    (frame,) = read_frames(_drawable_source(video), start=index, stop=index + 1)
    return frame


def render_frame(video: VectorVideo, look: Look | None, index: int) -> NDArray[np.uint8]:
    """Frame `index` with one look, or as it is: (H, W, 3) uint8 RGB. Raises `ValueError` when there is none."""
    frame = source_frame(video, index)
    return (frame if look is None else Renderer(video, [look]).draw(frame)[0]).rgb()


def swap(a: VectorVideo, b: VectorVideo, paths: Sequence[str | Path], **options: Any) -> None:
    """Exchange face colours: `paths[0]` is `a` with the colours of `b`, `paths[1]` is `b` with those of `a`.

    options: those of `transfer` and of `render`.
    """
    ours, theirs = paths
    drawing = {k: options.pop(k) for k in ("codec", "crf", "preset", "audio", "progress") if k in options}
    looks = transfer(a, b, **options), transfer(b, a, **options)
    render(a, [looks[0]], [ours], **drawing)
    render(b, [looks[1]], [theirs], **drawing)


def regions(video: VectorVideo, index: int) -> Iterator[tuple[int, Region]]:
    """(face, region) of every face that stands in frame `index`, by the clip-wide table."""
    for face in video.faces:
        data = video.face_frame(face.index, index)
        if data is None:
            continue
        region = open_region(data, table_labels(), video.media.width, video.media.height)
        if region is not None:
            yield face.index, region
