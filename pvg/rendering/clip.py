"""Algorithm 1, rendering: a vectorised clip and its looks give clips, or single frames.

Texture is never resampled, and what lies outside the matte keeps its bits. All looks of a pass share one reading of
the clip and one operator.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Literal

from pvg._arrays import Bytes
from pvg._threads import Sink, ahead, one_blas_thread
from pvg.asset import VectorVideo
from pvg.curves import table_labels
from pvg.errors import AssetError
from pvg.looks import Contrast, Look, contrast_of_both, exchange, transfer
from pvg.rendering.placed_face import PlacedFace, place_face
from pvg.rendering.renderer import Renderer
from pvg.video import Frame, MediaInfo, Patch, VideoWriter, probe, read_frames, write_image

Progress = Callable[[str, int, int], None]

_LOOKS_AT_ONCE = 3  # an encoder holds tens of frames: more looks are drawn in further passes over the clip


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


def render_frame(video: VectorVideo, look: Look | None, index: int) -> Bytes:
    """Frame `index` with one look, or as it is: (H, W, 3) uint8 RGB. Raises `ValueError` when there is none."""
    frame = source_frame(video, index)
    with one_blas_thread():
        return (frame if look is None else Renderer(video, [look]).draw(frame)[0]).rgb()


def swap(
    a: VectorVideo,
    b: VectorVideo | None = None,
    paths: str | Path | Sequence[str | Path] = (),
    *,
    faces: Literal["all"] | Sequence[int] = "all",
    contrast: Contrast | Sequence[Contrast] = "auto",
    **options: Any,
) -> None:
    """Exchange face colours, between two clips or between two faces of one.

    Two clips: `paths[0]` is `a` with the colours of `b`, `paths[1]` is `b` with those of `a`; faces: to be changed in
    each. One clip, without `b`: two `faces` of `a` exchange their colours in one clip, written to the one path.
    contrast: λ of both sides, or one for each: "auto" or a number, first that of `a` or of `faces[0]`.
    options: the others of `transfer` and of `render`. Raises `ValueError` for a clip and itself, and as those do.

        pvg.swap(video, paths="swapped.mp4", faces=(0, 1), contrast=(0.8, 1.2))
    """
    targets = [paths] if isinstance(paths, (str, Path)) else list(paths)
    if len(targets) != (1 if b is None else 2):
        raise ValueError(f"a swap within one clip has one path, one of two clips has two, not {len(targets)}")
    drawing = {k: options.pop(k) for k in ("codec", "crf", "preset", "audio", "progress") if k in options}
    if b is None:
        if faces == "all":
            raise ValueError("a swap within one clip is of two faces, such as faces=(0, 1)")
        render(a, [exchange(a, faces, contrast=contrast, **options)], targets, **drawing)
        return
    if a.source_sha256 == b.source_sha256:
        raise ValueError("a clip cannot be swapped with itself; give it alone, with two faces, such as faces=(0, 1)")
    ours, theirs = targets
    first, second = contrast_of_both(contrast)
    looks = (
        transfer(a, b, faces=faces, contrast=first, **options),
        transfer(b, a, faces=faces, contrast=second, **options),
    )
    render(a, [looks[0]], [ours], **drawing)
    render(b, [looks[1]], [theirs], **drawing)


def placed_faces(video: VectorVideo, index: int) -> Iterator[tuple[int, PlacedFace]]:
    """(face, where it is) of every face that stands in frame `index`, by the clip-wide table."""
    for face in video.faces:
        data = video.face_at(face.index, index)
        if data is None:
            continue
        placed = place_face(data, table_labels(), video.media.width, video.media.height)
        if placed is not None:
            yield face.index, placed
