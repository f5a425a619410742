"""A transfer or swap job: assets -> looks -> results. Nothing is ever vectorised here."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path

import pvg
from pvg.asset import VectorVideo
from pvg.looks import reference_face_of
from service.catalog import (
    Look,
    LookParams,
    Media,
    Output,
    OutputOptions,
    Report,
    content_type_of,
    jobs,
    look_params,
    media,
    render_request,
    results,
)
from service.ids import new_id
from service.storage import BlobMissingError, file_sha256
from worker.failures import OptionError
from worker.lease import LeaseLostError
from worker.run import Run

#: parts of one video's share of the job: finding the new colours, drawing; storing takes the rest
_TRANSFER, _RENDER = 0.05, 0.97
#: containers of a still picture; all others hold clips
IMAGE_CONTAINERS = frozenset({"png", "jpg", "webp"})


@dataclass(frozen=True)
class _Drawn:
    """One look as a file, not yet stored."""

    look: Look
    path: Path
    report: Report


def render(run: Run) -> bool:
    """Do the job. False when its lease was lost at the end, and nothing was published."""
    with run.database.read() as session:
        looks = jobs.looks(session, run.job.id)
        ids = {media_id for look in looks for media_id in (look.video_id, look.reference_id)}
        known = {media_id: media.get(session, media_id) for media_id in ids}
    present = {media_id: medium for media_id, medium in known.items() if medium is not None}
    if len(present) < len(known):  # deleted, and the lease was revoked with it
        raise LeaseLostError
    by_video: dict[str, list[Look]] = {}
    for look in looks:
        by_video.setdefault(look.video_id, []).append(look)
    drawn: list[_Drawn] = []
    for number, (video_id, group) in enumerate(by_video.items()):
        run.progress.expect(spans_of_video(number, len(by_video)))
        try:
            drawn += _render_video(run, present[video_id], group, present)
        except BlobMissingError as error:
            run.keeper.check()
            raise LeaseLostError from error
    return _publish(run, drawn, present)


def spans_of_video(number: int, count: int) -> dict[str, tuple[float, float]]:
    """The parts of the job, in [0, 1], that the stages of video ``number`` of ``count`` take."""
    start, share = number / count, 1 / count
    return {
        "transfer": (start, start + share * _TRANSFER),
        "render": (start + share * _TRANSFER, start + share * _RENDER),
    }


def _render_video(run: Run, video: Media, group: list[Look], present: dict[str, Media]) -> list[_Drawn]:
    """All looks of one video, up to three in one pass over it."""
    output = render_request(run.job).output
    with ExitStack() as stack:
        source = stack.enter_context(run.storage.local_path(video.source_key))
        canvas = _open(run, stack, video, source)
        suffix = _suffix(canvas, output)
        new_colors, reports = [], []
        with run.timed("transfer_s"):
            for done, look in enumerate(group):
                run.progress("transfer", done, len(group))
                reference = _open(run, stack, present[look.reference_id])
                params = look_params(look)
                new_colors.append(_transfer(canvas, reference, params))
                reports.append(_report(canvas, reference, params))
        paths = [run.draft(suffix) for _ in group]
        with run.timed("render_s"):
            try:
                pvg.render(
                    canvas,
                    new_colors,
                    paths,
                    codec=output.codec,
                    crf=output.crf,
                    preset=output.preset,
                    audio=output.audio,
                    progress=run.progress,
                )
            except ValueError as error:
                raise OptionError(str(error)) from error
    return [_Drawn(*one) for one in zip(group, paths, reports, strict=True)]


def _open(run: Run, stack: ExitStack, medium: Media, source: Path | None = None) -> VectorVideo:
    assert medium.asset_key is not None  # noqa: S101 - a job is released only when its media are ready
    path = stack.enter_context(run.storage.local_path(medium.asset_key))
    return stack.enter_context(VectorVideo(path, source))


def _transfer(video: VectorVideo, reference: VectorVideo, params: LookParams) -> pvg.Look:
    options = {field.name: getattr(params, field.name) for field in fields(LookParams)}
    try:
        if options.pop("exchange"):
            del options["reference_face"]
            return pvg.exchange(video, **options)
        return pvg.transfer(video, reference, **options)
    except ValueError as error:
        raise OptionError(str(error)) from error


def _report(video: VectorVideo, reference: VectorVideo, params: LookParams) -> Report:
    """How the video was vectorised, and the warnings of the faces that take part."""
    warnings = [
        f"video, face {face.index}: {warning}"
        for face in video.faces
        if params.faces == "all" or face.index in params.faces
        for warning in face.warnings
    ]
    if not params.exchange:
        face = reference_face_of(reference, params.reference_face)
        warnings += [f"reference, face {face.index}: {warning}" for warning in face.warnings]
    return Report(video.settings["mask"], video.settings["matching"], tuple(warnings))


def _suffix(video: VectorVideo, output: OutputOptions) -> str:
    container = output.container
    is_image = video.media.kind == "image"
    if container is None:
        return ".png" if is_image else ".mp4"
    if (container in IMAGE_CONTAINERS) != is_image:
        raise OptionError(f"{container} does not fit {'an image' if is_image else 'a clip'}")
    return f".{container}"


def _publish(run: Run, drawn: list[_Drawn], present: dict[str, Media]) -> bool:
    outputs: list[Output] = []
    published = False
    try:
        with run.timed("store_s"):
            for one in drawn:
                run.keeper.check()
                outputs.append(_store(run, one, present))
        run.keeper.flush()
        with run.database.write() as session:
            published = results.publish(
                session,
                run.lease,
                outputs,
                now=run.database.now(),
                timings=run.timings,
                ttl_s=run.settings.result_ttl_s,
            )
    finally:
        if not published:
            for output in outputs:
                run.storage.delete(output.key)
    return published


def _store(run: Run, drawn: _Drawn, present: dict[str, Media]) -> Output:
    look, path = drawn.look, drawn.path
    result_id = new_id("res")
    sha256, size = file_sha256(path), path.stat().st_size
    key = run.storage.key("result", sha256, result_id, path.suffix)
    run.storage.put(path, key)
    return Output(
        result_id=result_id,
        position=look.position,
        key=key,
        sha256=sha256,
        size_bytes=size,
        content_type=content_type_of(path.suffix),
        filename=f"{_stem(present[look.video_id])}-{_stem(present[look.reference_id])}{path.suffix}",
        report=drawn.report,
    )


def _stem(medium: Media) -> str:
    return Path(medium.filename).stem[:80] if medium.filename else medium.id
