"""A clip drawn in parts, anywhere and in any order, and joined by packet copy.

The source is never cut: every part reads it by frame number. Where parts begin follows from the clip alone, and each
has an encoder of its own with one thread, so that one worker and many give the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import av

from pvg._checks import whole_number
from pvg._targets import check_files
from pvg._threads import one_blas_thread
from pvg._version import __version__
from pvg.asset import VectorVideo, check_vectorized
from pvg.looks import Look, check_looks
from pvg.memory import looks_at_once
from pvg.rendering.canvas import Canvas, Encoding, plans_of, stored_canvas, stored_frames
from pvg.rendering.passes import LOOKS_AT_ONCE, MEMORY_BYTES, Progress, check_paths, drafts_of, draw
from pvg.video import ClipOfParts, PartWriter, PictureEncoder, can_join, join


def render_part(
    video: VectorVideo,
    looks: Sequence[Look],
    paths: Sequence[str | Path],
    *,
    start: int,
    stop: int,
    container: str,
    codec: str = "auto",
    crf: int | None = None,
    preset: str | None = None,
    memory_bytes: int = MEMORY_BYTES,
    progress: Progress | None = None,
) -> None:
    """Draw frames [start, stop) of every look into the part file of the same place in `paths`.

    container, codec, crf, preset: of the clip that the parts are for, see `render`; `can_join` tells which. A part has
    pictures alone, the first of them a key picture, and the same frames give the same bytes on every machine of one
    kind. memory_bytes, progress: see `render`; frames are counted within the part. Raises as `render`, and `ValueError`
    for frames that the clip does not have.
    """
    targets = _targets(video, looks, paths)
    memory_bytes = whole_number("memory_bytes", memory_bytes, 1)
    start, stop = whole_number("start", start, low=None), whole_number("stop", stop, low=None)
    check_looks(video, looks)
    if not 0 <= start < stop <= video.frame_count:
        raise ValueError(f"[{start}, {stop}) are no frames of a clip of {video.frame_count}")
    canvas = _clip(video, container, codec)
    encoding = Encoding(container, codec, crf, preset, "none")
    (plan,) = plans_of([Path("clip")], canvas, encoding)
    clip = _of_parts(video, crf, preset)

    at_once = looks_at_once(canvas.info, memory_bytes, most=LOOKS_AT_ONCE, codec=plan.codec)
    with one_blas_thread(), drafts_of(targets) as drafts:

        def writer(k: int) -> PartWriter:
            name = targets[k].name
            encoder = PictureEncoder(
                canvas.info, canvas.info.format, plan, crf=crf, preset=preset, part=True, name=name
            )
            return PartWriter(drafts[k], encoder, clip, start=start, stop=stop)

        draw(
            video,
            looks,
            lambda: stored_frames(video, start, stop),
            writer,
            count=stop - start,
            at_once=at_once,
            progress=progress,
        )


def join_parts(
    video: VectorVideo,
    parts: Sequence[Sequence[str | Path]],
    paths: Sequence[str | Path],
    *,
    container: str | None = None,
    codec: str = "auto",
    crf: int | None = None,
    preset: str | None = None,
    audio: Literal["copy", "none"] = "copy",
) -> list[tuple[str, ...]]:
    """Write the clip of each look from its parts, `parts[k]` in their order to `paths[k]`; no picture is decoded.

    container, codec, crf, preset: those of the parts; container None follows from the suffix. Sound, other tracks and
    tags of the clip go along as with `render`, whose lines are returned. Files appear under their names only when all
    are complete. The same parts give the same bytes. Raises `AssetError` when the source clip is missing or another
    one, `PartError` for a part that is missing, damaged or of another clip, place or manner, and where frames are not
    as many as the clip's, `ValueError` on options that do not fit.
    """
    targets = _targets(video, parts, paths, [Path(file) for files in parts for file in files])
    canvas = _clip(video, container or (targets[0].suffix if targets else "mp4"), codec)
    plans = plans_of(targets, canvas, Encoding(container, codec, crf, preset, audio))
    of = _of_parts(video, crf, preset)
    with drafts_of(targets) as drafts:
        for files, draft, plan in zip(parts, drafts, plans, strict=True):
            join([Path(file) for file in files], draft, canvas.info, plan, of)
    return [canvas.info.warnings + plan.warnings for plan in plans]


def _of_parts(video: VectorVideo, crf: int | None, preset: str | None) -> ClipOfParts:
    made_by = f"pvg {__version__}, PyAV {av.__version__}"
    return ClipOfParts(video.source_sha256, video.frame_count, None if crf is None else int(crf), preset, made_by)


def _targets(
    video: VectorVideo, items: Sequence[object], paths: Sequence[str | Path], inputs: Sequence[Path] = ()
) -> list[Path]:
    check_vectorized(video)
    check_paths(items, paths)
    targets = [Path(path) for path in paths]
    check_files(targets, [video.source, video.path, *inputs])
    return targets


def _clip(video: VectorVideo, container: str, codec: str) -> Canvas:
    if not can_join(container.lower(), codec):
        raise ValueError(f"{codec} in {container} is not made of parts: render it whole")
    canvas = stored_canvas(video)
    if canvas.info.kind != "video":
        raise ValueError("a picture has no parts: render it whole")
    return canvas
