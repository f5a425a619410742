"""Algorithm 1, rendering: a vectorised clip and its looks give clips, or single frames.

With f_i the Laplacian of the clip itself, eq. (1) for new boundary colours g' and a coefficient lambda reads

    u' = lambda I + H(g' - lambda g),     H: harmonic extension from the curves.

It is affine in every pixel, so it is applied to the planes the clip is coded in: a smooth membrane is added under the
soft matte, texture is never resampled, and what lies outside the matte keeps its bits. All looks share one operator.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pvg._threads import Sink, ahead, one_blas_thread
from pvg.asset import VectorVideo
from pvg.curves.labels import CurveLabels, Floats, labels_by_length, stack_points, table_labels
from pvg.curves.propagation import Chain
from pvg.errors import AssetError
from pvg.looks.look import Look, transfer
from pvg.membrane.lattice import TOLERANCE
from pvg.rendering.placed_face import Region, divide_overlaps, open_region
from pvg.rendering.planes import Change, apply_change, protected_alpha
from pvg.video import Frame, MediaInfo, Patch, VideoWriter, probe, read_frames, write_image

Progress = Callable[[str, int, int], None]

_AUTO_EXPONENT = 0.6  # METHOD 7b: 0.5 to 0.75 keeps eyes and brows crisp, 1 looks harsh
_AUTO_RANGE = (0.5, 1.6)  # more turns lips and lids white where a dark face is made pale
_CHROMA_RANGE = (0.25, 1.5)  # more would lift the noise that coding leaves in chroma
_LEAST_CHROMA = 4.0  # code values added to both sides of the ratio, so that grey skin does not explode
_CHAIN_SPACING_PX = 2.0
_HF_LEVELS = 128.0
_LOOKS_AT_ONCE = 3  # an encoder holds tens of frames: more looks are drawn in further passes over the clip


def _contrast_at_curves(look: Look, g: Floats, new: Floats) -> Floats | float:
    """Lambda of a look: a number, or (S, 2) values at the curves that follow what is asked for, of luma and chroma.

    g, new: (S, 3) luma and chroma. Chroma keeps its proportions: what is a shade redder or paler than the skin around
    it stays so by as much of the new skin's chroma. With luma's lambda a highlight, paler than the skin, would pass
    grey and turn blue where skin is made pale.
    """
    if look.contrast != "auto":
        return 1.0 + look.strength * (look.contrast - 1.0)
    luma = (np.maximum(new[:, 0], 0.0) + 1.0) / (np.maximum(g[:, 0], 0.0) + 1.0)
    chroma = (np.hypot(new[:, 1], new[:, 2]) + _LEAST_CHROMA) / (np.hypot(g[:, 1], g[:, 2]) + _LEAST_CHROMA)
    fields = [np.clip(luma**_AUTO_EXPONENT, *_AUTO_RANGE), np.clip(chroma, *_CHROMA_RANGE)]
    return np.stack(fields, axis=1).astype(np.float32)


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
        """One frame for every look, in their order; untouched frames are `frame` itself."""
        return [frame.patched(patches) for patches in self.patches(frame)]

    def patches(self, frame: Frame) -> list[list[Patch]]:
        """What every look changes in the frame, in their order, each to be laid over it in its order."""
        out: list[list[Patch]] = [[] for _ in self.looks]
        for face, region, colors in self._regions(frame):
            if colors is not None:
                self._draw_face(frame, region, self._with_face[face], colors, out)
        return out

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
            if region is not None:
                found.append((face, region, colors))
        divided = divide_overlaps([region for _, region, _ in found])
        return [(face, region, colors) for (face, _, colors), region in zip(found, divided, strict=True)]

    def _draw_face(
        self, frame: Frame, region: Region, which: list[int], colors: Floats, out: list[list[Patch]]
    ) -> None:
        to_planes = frame.format.opponent.matrix.astype(np.float32).T
        g = colors[:, :3] @ to_planes
        channels: list[Floats] = []
        changes: list[Change] = []
        count, low = 0, None
        if any(self.looks[i].contrast not in ("auto", 1.0) for i in which):
            channels, count, low = [g], 3, 0
        for k, i in enumerate(which):
            new = colors[:, 3 + 3 * k : 6 + 3 * k] @ to_planes
            contrast = _contrast_at_curves(self.looks[i], g, new)
            if isinstance(contrast, float):
                channels.append(new - contrast * g)
                changes.append(Change(count, contrast, low_channel=low))
                count += 3
            else:
                channels += [new - contrast[:, [0, 1, 1]] * g, contrast]
                changes.append(Change(count, contrast_channel=count + 3))
                count += 5
        tolerance = np.full(count, TOLERANCE * 2.0 ** (frame.format.depth - 8), np.float32)
        for change in changes:
            if change.contrast_channel is not None:
                tolerance[change.contrast_channel : change.contrast_channel + 2] /= _HF_LEVELS  # it multiplies lambda
        membrane = region.membrane(np.concatenate(channels, axis=1), tolerance=tolerance)
        alphas: dict[tuple[str, ...], Floats] = {}
        alike = len({self.looks[i].protect for i in which}) == 1
        for i, change in zip(which, changes, strict=True):
            protect = self.looks[i].protect
            if protect not in alphas:
                alphas[protect] = protected_alpha(region, protect, in_place=alike)
            out[i] += apply_change(frame, (region.x, region.y), alphas[protect], membrane, change, under=out[i])


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
    """Render every look of `looks` to the path of the same place in `paths`, up to three in one pass over the clip.

    The container follows from the suffix: .mp4, .mov, .mkv, .webm; .png, .jpg, .webp for an image. codec: "auto",
    "h264", "hevc", "vp9", "av1";  crf, preset: the encoder's own scales;  audio: "copy" or "none".
    progress: called as ("render", frames done, frames), counted over all passes; what it raises ends the work and
    passes through. Files appear under their names only when all are complete. Raises `AssetError` when the source clip
    is missing or another one, `MediaError` when it cannot be read, `ValueError` on options that do not fit.
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
        with one_blas_thread():
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
    # one encoder may use all cores; several share them, which costs less memory and processor time
    threads = 0 if len(looks) == 1 else max(1, (os.cpu_count() or 1) // min(len(looks), _LOOKS_AT_ONCE))
    parts = [slice(i, i + _LOOKS_AT_ONCE) for i in range(0, len(looks), _LOOKS_AT_ONCE)]
    for done, part in enumerate(parts):
        renderer = Renderer(video, looks[part])
        with ExitStack() as stack:
            writers = [VideoWriter(path, info, info.format, threads=threads, **options) for path in paths[part]]
            sinks = [Sink(_writing(stack.enter_context(writer))) for writer in writers]
            for sink in sinks:
                stack.enter_context(sink)
            frames = stack.enter_context(closing(ahead(read_frames(video.require_source()))))
            for frame in frames:
                for sink, patches in zip(sinks, renderer.patches(frame), strict=True):
                    sink.put((frame, patches))
                if progress is not None:
                    progress("render", done * video.frame_count + frame.index + 1, len(parts) * video.frame_count)


def _writing(writer: VideoWriter) -> Callable[[tuple[Frame, list[Patch]]], None]:
    return lambda item: writer.write(*item)


def source_frame(video: VectorVideo, index: int) -> Frame:
    """Frame `index` of the source clip. Raises `ValueError` when there is none."""
    if not 0 <= index < video.frame_count:
        raise ValueError(f"no frame {index}; the clip has {video.frame_count}")
    (frame,) = read_frames(_drawable_source(video), start=index, stop=index + 1)
    return frame


def render_frame(video: VectorVideo, look: Look | None, index: int) -> NDArray[np.uint8]:
    """Frame `index` with one look, or as it is: (H, W, 3) uint8 RGB. Raises `ValueError` when there is none."""
    frame = source_frame(video, index)
    with one_blas_thread():
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
