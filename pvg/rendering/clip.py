"""Algorithm 1, rendering: a vectorised clip and its looks give clips, or single frames.

Texture is never resampled, and what lies outside the matte keeps its bits. All looks of a pass share one reading of
the clip and one operator.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from io import TextIOBase
from pathlib import Path
from typing import BinaryIO, Literal, Unpack

import numpy as np

from pvg._arrays import Bytes
from pvg._checks import whole_number
from pvg._processors import processors
from pvg._targets import check_files
from pvg._threads import one_blas_thread
from pvg.asset import VectorVideo, check_vectorized
from pvg.curves import table_labels
from pvg.errors import AssetError
from pvg.looks import Contrast, Look, LookOptions, check_looks, contrast_of_both, exchange, transfer
from pvg.memory import looks_at_once, processors_at_once
from pvg.rendering.canvas import (
    Canvas,
    Encoding,
    check_in_full,
    check_index,
    check_picture,
    frame_of_file,
    piped_canvas,
    plans_of,
    stored_canvas,
    writer_of,
)
from pvg.rendering.passes import LOOKS_AT_ONCE, MEMORY_BYTES, Progress, check_paths, drafts_of, draw
from pvg.rendering.placed_face import PlacedFace, place_face
from pvg.rendering.renderer import Renderer
from pvg.video import (
    Frame,
    Plan,
    VideoWriter,
    Y4mWriter,
    lost_in_picture,
    read_picture_metadata,
    write_image,
)


def render(
    video: VectorVideo,
    looks: Sequence[Look],
    paths: Sequence[str | Path | BinaryIO],
    *,
    container: str | None = None,
    codec: str = "auto",
    crf: int | None = None,
    preset: str | None = None,
    audio: Literal["copy", "none"] = "copy",
    pictures: BinaryIO | None = None,
    memory_bytes: int = MEMORY_BYTES,
    progress: Progress | None = None,
) -> list[tuple[str, ...]]:
    """Render every look of `looks` to the path of the same place in `paths`, up to three in one pass over the clip.

    container: "mp4", "mov", "mkv", "webm"; None follows from the suffix: .mp4, .mov, .mkv, .webm; .png, .tiff, .jpg,
    .webp for an image, which keeps its profile, EXIF, alpha and, in PNG and TIFF, its 16 bits. A binary stream in the
    place of a path is written to as "nut" (None) or "y4m".
    codec: "auto", "h264", "hevc", "vp9" or "av1", or for editing "prores" (422 HQ), "prores4444", "dnxhr", "ffv1";
    crf, preset: the encoder's own scales, by default 18 (h264), 20 (hevc), 28 (vp9) or 26 (av1), and "veryfast";
    audio: "copy" or "none", all sound tracks or no sound. A picture has none of these four, which are then those of
    clips that the same options are for.
    pictures: NUT or YUV4MPEG2, whose frames are drawn on instead of the clip's, of the same size and number; tracks
    and tags are then those of the clip, where it is there.
    Tracks, chapters, tags, timecode, HDR10 metadata and fields of the clip go along as far as the container and the
    codec hold them. Returns for each path what is not as in the clip or picture, a line each.
    memory_bytes: what a pass over the clip is to take at most; where three looks would take more by `pvg.memory`, a
    pass has two or one, and its encoders have fewer threads.
    progress: called as ("render", frames done, frames), counted over all passes, once for a picture; what it raises
    ends the work and passes through. Files appear under their names only when all are complete. Raises `AssetError`
    when the source clip is missing or another one, `MediaError` when it cannot be read, and before anything is drawn
    `ValueError` on options that do not fit, looks of another clip and paths that are one or in the place of the source,
    `OSError` where a path cannot be written.
    """
    check_paths(looks, paths)
    if not looks:
        return []
    if pictures is not None and (isinstance(pictures, TextIOBase) or not hasattr(pictures, "read")):
        raise ValueError(f"pictures must be a binary stream, not {pictures!r}")
    if pictures is not None and len(looks) > LOOKS_AT_ONCE:
        raise ValueError(f"pictures that come by a pipe are drawn once, for at most {LOOKS_AT_ONCE} looks")
    encoding, job = Encoding(container, codec, crf, preset, audio), _Job(video, looks, _targets(paths, [video]))
    return _draw_and_publish([job], encoding, pictures, memory_bytes, progress)


@dataclass(frozen=True)
class _Job:
    """Looks of one clip or picture, and where each goes."""

    video: VectorVideo
    looks: Sequence[Look]
    targets: Sequence[Path | BinaryIO]


def _targets(paths: Sequence[str | Path | BinaryIO], videos: Sequence[VectorVideo]) -> list[Path | BinaryIO]:
    """Where results go. Raises ValueError or OSError where they cannot, or would replace what is drawn on."""
    check_vectorized(*videos)
    targets = [Path(path) if isinstance(path, (str, os.PathLike)) else path for path in paths]
    for target in targets:
        if not isinstance(target, Path) and (isinstance(target, TextIOBase) or not hasattr(target, "write")):
            raise ValueError(f"each of paths must be a path or a binary stream, not {target!r}")
    streams = [id(target) for target in targets if not isinstance(target, Path)]
    if len(set(streams)) != len(streams):
        raise ValueError("two looks would be written to the same stream")
    read = [path for video in videos for path in (video.source, video.path)]
    check_files([target for target in targets if isinstance(target, Path)], read)
    return targets


def _draw_and_publish(
    jobs: Sequence[_Job],
    encoding: Encoding,
    pictures: BinaryIO | None,
    memory_bytes: int,
    progress: Progress | None,
) -> list[tuple[str, ...]]:
    """Draw all jobs, each planned before the first is drawn, and publish them together; the lines of their targets."""
    memory_bytes = whole_number("memory_bytes", memory_bytes, 1)
    lost = []
    for job in jobs:
        check_looks(job.video, job.looks)
    with one_blas_thread(), ExitStack() as stack:
        drafts = stack.enter_context(drafts_of([target for job in jobs for target in job.targets]))
        canvases = [stack.enter_context(_canvas(job.video, pictures)) for job in jobs]
        plans = [_plans(job, canvas, encoding) for job, canvas in zip(jobs, canvases, strict=True)]
        at_once = [
            len(job.looks) if pictures is not None else _at_once(job, canvas, planned, memory_bytes)
            for job, canvas, planned in zip(jobs, canvases, plans, strict=True)
        ]
        frames = [job.video.frame_count * -(-len(job.looks) // most) for job, most in zip(jobs, at_once, strict=True)]
        for k, (job, canvas, planned) in enumerate(zip(jobs, canvases, plans, strict=True)):
            own, drafts = drafts[: len(job.looks)], drafts[len(job.looks) :]
            told = _part_of(progress, sum(frames[:k]), sum(frames))
            if canvas.info.kind == "image":
                lost += _render_image(job, canvas, own)
                told("render", 1, 1)
                continue
            threads = _threads(len(job.looks), at_once[k], canvas, planned, memory_bytes)
            _render_clip(job, canvas, own, planned, encoding, at_once[k], threads, told)
            lost += [canvas.info.warnings + plan.warnings for plan in planned]
    return lost


def _at_once(job: _Job, canvas: Canvas, plans: Sequence[Plan], memory_bytes: int) -> int:
    """How many looks a pass draws; all of a picture, which has no plans."""
    most = (looks_at_once(canvas.info, memory_bytes, most=LOOKS_AT_ONCE, codec=plan.codec) for plan in plans)
    return min(most, default=len(job.looks))


def _threads(count: int, at_once: int, canvas: Canvas, plans: Sequence[Plan], memory_bytes: int) -> int:
    """Of each encoder; 0 for as many as suit the machine.

    One may use all processors; several share them, which costs less memory and processor time.
    """
    together, most = min(count, at_once), processors()
    used = min(processors_at_once(canvas.info, together, memory_bytes, most=most, codec=plan.codec) for plan in plans)
    return 0 if count == 1 and used == most else max(1, used // together)


def _part_of(progress: Progress | None, before: int, frames: int) -> Progress:
    """What tells of one job's frames among those of all; before: of the jobs that are done."""
    if progress is None:
        return lambda stage, done, total: None
    return lambda stage, done, total: progress(stage, before + done, frames)


def _plans(job: _Job, canvas: Canvas, encoding: Encoding) -> list[Plan]:
    """The plan of each target of a clip; a picture's are only looked at."""
    if canvas.info.kind != "image":
        return plans_of(job.targets, canvas, encoding)
    for target in job.targets:
        check_picture(target, encoding)
    return []


def _canvas(video: VectorVideo, pictures: BinaryIO | None) -> AbstractContextManager[Canvas]:
    if pictures is not None:
        if video.settings["reference"] or video.media.kind != "video":
            raise AssetError(f"{video.path.name} is no clip in full: pictures by a pipe cannot be drawn on")
        return piped_canvas(video, pictures)
    return nullcontext(stored_canvas(video))


def _render_image(job: _Job, canvas: Canvas, drafts: Sequence[Path | BinaryIO]) -> list[tuple[str, ...]]:
    """Write a picture's looks; what is not kept of it, a line each."""
    source, partials = job.video.require_source(), [draft for draft in drafts if isinstance(draft, Path)]
    (frame,), metadata = canvas.frames(), read_picture_metadata(source)
    for drawn, path in zip(Renderer(job.video, job.looks).draw(frame), partials, strict=True):
        write_image(path, np.stack(drawn.planes, axis=-1), alpha=drawn.alpha, metadata=metadata)
    return [canvas.info.warnings + lost_in_picture(source, path) for path in partials]


def _render_clip(
    job: _Job,
    canvas: Canvas,
    drafts: Sequence[Path | BinaryIO],
    plans: Sequence[Plan],
    encoding: Encoding,
    at_once: int,
    threads: int,
    progress: Progress,
) -> None:
    def writer(k: int) -> VideoWriter | Y4mWriter:
        return writer_of(drafts[k], canvas.info, plans[k], encoding, threads)

    frames = job.video.frame_count
    draw(job.video, job.looks, canvas.frames, writer, count=frames, at_once=at_once, progress=progress)


def source_frame(video: VectorVideo, index: int) -> Frame:
    """Frame `index` of the source clip, not to be written to. Raises `ValueError` when there is none."""
    check_vectorized(video)
    index = whole_number("index", index, low=None)
    check_index(video, index)
    check_in_full(video)
    return frame_of_file(video, index)


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
    reference_face: int | None = None,
    container: str | None = None,
    codec: str = "auto",
    crf: int | None = None,
    preset: str | None = None,
    audio: Literal["copy", "none"] = "copy",
    memory_bytes: int = MEMORY_BYTES,
    progress: Progress | None = None,
    **options: Unpack[LookOptions],
) -> list[tuple[str, ...]]:
    """Exchange face colours, between two clips or between two faces of one.

    Two clips: `paths[0]` is `a` with the colours of `b`, `paths[1]` is `b` with those of `a`; faces: to be changed in
    each. One clip, without `b`: two `faces` of `a` exchange their colours in one clip, written to the one path.
    contrast: λ of both sides, or one for each: "auto" or a number, first that of `a` or of `faces[0]`.
    reference_face: of `transfer`, in each of two clips; within one clip there is none.
    container, codec, crf, preset, audio, memory_bytes, progress: of `render`.
    options: strength, match, makeup, light, scene, protect, extent, beta, iterations and seed of `transfer`.
    Returns as `render`; both files appear when both are complete. Raises `ValueError` for a clip and itself, and as
    those do.

        pvg.swap(video, paths="swapped.mp4", faces=(0, 1), contrast=(0.8, 1.2))
    """
    if not isinstance(paths, (str, os.PathLike, Iterable)):
        raise ValueError(f"paths must be a path or two of them, not {paths!r}")
    given = [paths] if isinstance(paths, (str, os.PathLike)) else list(paths)
    if len(given) != (1 if b is None else 2):
        raise ValueError(f"a swap within one clip has one path, one of two clips has two, not {len(given)}")
    check_vectorized(*([a] if b is None else [a, b]))
    encoding = Encoding(container, codec, crf, preset, audio)
    if b is None:
        if isinstance(faces, str):
            raise ValueError("a swap within one clip is of two faces, such as faces=(0, 1)")
        look = exchange(a, faces, contrast=contrast, reference_face=reference_face, **options)
        jobs = [_Job(a, [look], _targets(given, [a]))]
    else:
        if a.source_sha256 == b.source_sha256:
            raise ValueError("a clip cannot be swapped with itself; give it alone, with two faces: faces=(0, 1)")
        ours, theirs = _targets(given, [a, b])
        first, second = contrast_of_both(contrast)
        jobs = [
            _Job(one, [transfer(one, other, faces=faces, contrast=own, reference_face=reference_face, **options)], [to])
            for one, other, own, to in ((a, b, first, ours), (b, a, second, theirs))
        ]
    return _draw_and_publish(jobs, encoding, None, memory_bytes, progress)


def placed_faces(video: VectorVideo, index: int) -> Iterator[tuple[int, PlacedFace]]:
    """(face, where it is) of every face that stands in frame `index`, by the clip-wide table."""
    for face in video.faces:
        data = video.face_at(face.index, index)
        if data is None:
            continue
        placed = place_face(data, table_labels(), video.media.width, video.media.height)
        if placed is not None:
            yield face.index, placed
