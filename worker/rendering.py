"""A transfer or swap job: assets -> looks -> results. Nothing is ever vectorised here."""

from __future__ import annotations

import unicodedata
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from service.catalog import (
    IMAGE_CONTAINERS,
    Extra,
    Job,
    JobKind,
    Look,
    Media,
    Output,
    OutputOptions,
    PartName,
    PartOf,
    Report,
    content_type_of,
    jobs,
    look_params,
    media,
    render_request,
    results,
)
from service.catalog.requests import no_face
from service.ids import new_id
from service.storage import BlobMissingError
from worker.answers import LookAnswer, RenderAnswer, VerifyAnswer, checked, made
from worker.failures import LostAssetsError, OptionError, SourceLostError, UnreadyError, without_files
from worker.lease import LeaseLostError
from worker.run import Run
from worker.sandbox import CrashError, MethodError
from worker.unpublished import Unpublished

#: parts of one video's share of the job: finding the new colours, drawing, extras; storing takes the rest
_TRANSFER, _RENDER = 0.05, 0.97
#: where drawing ends when there are extras: a matte is another reading of the clip for each look, a cube one frame
_RENDER_BEFORE = {"cube": 0.93, "matte": 0.6}


@dataclass(frozen=True)
class _Extra:
    """A part of a look as a file, not yet stored; see `PartOf`."""

    part: PartName
    person: int
    path: Path


@dataclass(frozen=True)
class DrawnLook:
    """One look as a file, not yet stored, and what was made beside it."""

    look: Look
    path: Path
    report: Report
    extras: tuple[_Extra, ...]


def render(run: Run) -> bool:
    """Do the job. False when its lease was lost at the end, and nothing was published."""
    looks, present = wanted(run)
    by_video: dict[str, list[Look]] = {}
    for look in looks:
        by_video.setdefault(look.video_id, []).append(look)
    drawn: list[DrawnLook] = []
    extras = render_request(run.job).output.extras
    for number, (video_id, group) in enumerate(by_video.items()):
        run.progress.expect(spans_of_video(number, len(by_video), extras))
        with telling_what_is_lost(run, present):
            drawn += _render_video(run, present[video_id], group, present)
    return publish(run, drawn, present)


def wanted(run: Run) -> tuple[list[Look], dict[str, Media]]:
    """The looks to make, of the whole job, and the media they need.

    Raises `LeaseLostError` when one was deleted, `UnreadyError` when one is to be waited for again, and `OptionError`
    for a face that is not there.
    """
    looks, known, unready = run.read(lambda session: _known(session, run.job))
    present = {media_id: medium for media_id, medium in known.items() if medium is not None}
    if len(present) < len(known):  # the lease was revoked with it
        raise LeaseLostError
    if unready:
        raise UnreadyError(unready)
    if run.job.parent_id is None:  # else it was looked at before the job was cut into parts
        for look in looks:
            _check_faces(JobKind(run.job.kind), look, present)
    return looks, present


def _check_faces(kind: JobKind, look: Look, present: dict[str, Media]) -> None:
    """Raise `OptionError`, which says where, for a face that nobody knew to be missing when the look was asked for."""
    params, place = look_params(look), jobs.look_place(kind, look)
    chosen = () if params.faces == "all" else params.faces
    wanted_of = {"faces": (look.video_id, "clip", chosen)}
    if params.reference_face is not None:
        wanted_of["reference_face"] = (look.reference_id, "reference", (params.reference_face,))
    for name, (media_id, what, faces) in wanted_of.items():
        count = len(present[media_id].faces)
        if count and (missing := [face for face in faces if face >= count]):
            raise OptionError(no_face(missing[0], count, f"this {what}"), f"{place}/{name}")


def _known(session: Session, job: Job) -> tuple[list[Look], dict[str, Media | None], set[str]]:
    looks = jobs.looks(session, job.parent_id or job.id)
    ids = {media_id for look in looks for media_id in (look.video_id, look.reference_id)}
    found = {media_id: media.get(session, media_id) for media_id in ids}
    return looks, found, media.unready(session, job, [one for one in found.values() if one is not None])


@contextmanager
def telling_what_is_lost(run: Run, present: dict[str, Media]) -> Iterator[None]:
    """When the block fails for it, raise `SourceLostError` or `LostAssetsError` of those of these media whose files
    are gone or cannot be read, or whose assets an earlier vectoriser made.
    """
    try:
        yield
    except BlobMissingError as error:
        _say_what_is_lost(run, present, error)
        raise
    except MethodError as error:
        if error.kind == "AssetError":
            _say_what_is_lost(run, present, error)
        raise without_files(error, present.values(), run.keys) from error


def _say_what_is_lost(run: Run, present: dict[str, Media], error: Exception) -> None:
    """Raise what is lost of these media, if anything.

    One that was deleted meanwhile may be told as lost: the lease was revoked with it, so nothing comes of that.
    """
    for medium in present.values():
        if not run.patience(partial(run.storage.exists, medium.source_key)):
            raise SourceLostError(medium.id) from error
    remade = _remade(run, list(present.values()))
    lost = {
        medium.id: medium.asset_key
        for medium in present.values()
        if not _is_usable(run, medium, remade=medium.id in remade)
    }
    if lost:
        raise LostAssetsError(lost) from error


def _is_usable(run: Run, medium: Media, *, remade: bool) -> bool:
    try:
        with ExitStack() as stack:
            asset = _asset(run, stack, medium)
            arguments = {"asset": str(asset), "remade": [str(asset)] if remade else []}
            found = run.call("verify", arguments, read=[asset], folder=run.draft_folder())
    except BlobMissingError:
        return False
    return checked(VerifyAnswer, found).usable


def _remade(run: Run, of: Sequence[Media]) -> set[str]:
    """The ids of those that were vectorised for this job, or since. They are taken as they are: while workers of two
    versions run, an earlier one may have made them.
    """
    return run.read(lambda session: media.made_since_asked(session, run.job, of))


def spans_of_video(number: int, count: int, extras: Collection[Extra] = ()) -> dict[str, tuple[float, float]]:
    """The parts of the job, in [0, 1], that the stages of video ``number`` of ``count`` take."""
    start, share = number / count, 1 / count
    drawn = min([_RENDER, *(_RENDER_BEFORE[extra] for extra in extras)])
    spans = {
        "transfer": (start, start + share * _TRANSFER),
        "render": (start + share * _TRANSFER, start + share * drawn),
    }
    if extras:
        spans["extras"] = (start + share * drawn, start + share * _RENDER)
    return spans


def _render_video(run: Run, video: Media, group: list[Look], present: dict[str, Media]) -> list[DrawnLook]:
    """All looks of one video, in one process."""
    output = render_request(run.job).output
    folder, suffix = run.draft_folder(), suffix_of(video, output)
    names = [f"look-{number}{suffix}" for number in range(len(group))]
    extras = [folder / f"extras-{number}" for number in range(len(group))]
    with ExitStack() as stack:
        arguments, read = inputs(run, stack, video, group, present)
        arguments |= {"paths": [str(folder / name) for name in names], "extras": [str(path) for path in extras]}
        found = run.call("render", arguments, read=read, folder=folder)
    answer = checked(RenderAnswer, found)
    if len(answer.looks) != len(group):
        raise CrashError("its process answered for other looks")
    run.add_timings(answer.timings.items())
    return [
        drawn_look(look, made(folder, name), said, path)
        for look, name, said, path in zip(group, names, answer.looks, extras, strict=True)
    ]


def inputs(
    run: Run, stack: ExitStack, video: Media, group: list[Look], present: dict[str, Media]
) -> tuple[dict[str, Any], list[Path]]:
    """What every call about looks of one video is told, and the files it reads: there until the stack is closed."""
    source = stack.enter_context(run.local_path(video.source_key))
    media_ids = sorted({video.id, *(look.reference_id for look in group)})
    assets = {media_id: _asset(run, stack, present[media_id]) for media_id in media_ids}
    remade = _remade(run, [present[media_id] for media_id in media_ids])
    arguments = {
        "source": str(source),
        "asset": str(assets[video.id]),
        "remade": [str(assets[media_id]) for media_id in sorted(remade)],
        "looks": [{"reference": str(assets[look.reference_id]), "params": asdict(look_params(look))} for look in group],
        "output": asdict(render_request(run.job).output),
    }
    return arguments, [source, *assets.values()]


def _asset(run: Run, stack: ExitStack, medium: Media) -> Path:
    assert medium.asset_key is not None  # noqa: S101 - a job is released only when its media are ready
    return stack.enter_context(run.local_path(medium.asset_key))


def drawn_look(look: Look, path: Path, said: LookAnswer, extras: Path) -> DrawnLook:
    """What was drawn, with what its process says of it."""
    report = Report(
        mask=said.mask,
        matching=said.matching,
        input_color=said.input_color,
        warnings=(*said.warnings, *(f"output: {line}" for line in said.output_warnings)),
    )
    files = [_Extra(extra.part, extra.person, made(extras, extra.name)) for extra in said.extras]
    return DrawnLook(look, path, report, tuple(files))


def suffix_of(video: Media, output: OutputOptions) -> str:
    """Of the file that a look of this video becomes. Raises `OptionError` when the container is not of its kind."""
    container = output.container
    is_image = (video.info or {}).get("kind") == "image"
    if container is None:
        return ".png" if is_image else ".mp4"
    if (container in IMAGE_CONTAINERS) != is_image:
        raise OptionError(f"{container} does not fit {'an image' if is_image else 'a clip'}", "/output/container")
    return f".{container}"


def publish(run: Run, drawn: list[DrawnLook], present: dict[str, Media]) -> bool:
    """Store the looks and end the job with them. False when its lease was lost: nothing was published."""
    names = names_of_files(drawn, present)
    with Unpublished(run) as unpublished:
        with run.timed("store_s"):
            outputs = [output for one in drawn for output in _store(unpublished, one, names[one.look.position])]
        return unpublished.record(lambda: _record(run, outputs, present))


def _record(run: Run, outputs: list[Output], present: Collection[str]) -> bool:
    """End the job with its outputs, whose media are ``present`` and are used until then: results go with them.

    True as well when a call before has done so, and its answer was lost.
    """
    with run.database.write() as session:
        now = run.database.now()
        used = media.locked(session, present)  # before the job, as who asks for looks of them does
        published = results.publish(
            session, run.lease, outputs, now=now, timings=run.timings, ttl_s=run.settings.result_ttl_s
        )
        if published:
            media.use(used, now=now, ttl_s=run.settings.media_ttl_s)
        return published or (bool(outputs) and results.get(session, outputs[0].result_id) is not None)


def names_of_files(drawn: Collection[DrawnLook], present: dict[str, Media]) -> dict[int, tuple[str, ...]]:
    """What the files of a job's looks are called, by the looks' positions: each result's, then those of its extras.

    They are made of the names of video and reference. Of looks that would share a name the first in order has it, and
    those after it have a number, which no other look's own name ends with. All of a job are distinct, also where a
    folder tells no case.
    """
    looks = sorted(drawn, key=lambda one: one.look.position)
    stems = [f"{_stem(present[one.look.video_id])}-{_stem(present[one.look.reference_id])}" for one in looks]
    own = set().union(*(_as_compared(_names(one, stem)) for one, stem in zip(looks, stems, strict=True)))
    names: dict[int, tuple[str, ...]] = {}
    taken: set[str] = set()
    for one, stem in zip(looks, stems, strict=True):
        found, number = _names(one, stem), 1
        while not taken.isdisjoint(_as_compared(found)) or (number > 1 and not own.isdisjoint(_as_compared(found))):
            number += 1
            found = _names(one, f"{stem}-{number}")
        names[one.look.position] = found
        taken |= _as_compared(found)
    return names


def _names(drawn: DrawnLook, stem: str) -> tuple[str, ...]:
    return f"{stem}{drawn.path.suffix}", *(f"{stem}-{extra.path.name}" for extra in drawn.extras)


def _as_compared(names: Collection[str]) -> set[str]:
    """As file systems compare names that tell neither case nor how a letter is composed."""
    return {unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold()) for name in names}


def _store(unpublished: Unpublished, drawn: DrawnLook, names: tuple[str, ...]) -> Iterator[Output]:
    """Store a look and what was made beside it, under these names."""
    look = drawn.look
    main = _stored(unpublished, look, drawn.path, names[0], report=drawn.report)
    yield main
    for extra, name in zip(drawn.extras, names[1:], strict=True):
        part_of = PartOf(main.result_id, extra.part, extra.person)
        yield _stored(unpublished, look, extra.path, name, part_of=part_of)


def _stored(
    unpublished: Unpublished,
    look: Look,
    path: Path,
    filename: str,
    *,
    report: Report | None = None,
    part_of: PartOf | None = None,
) -> Output:
    result_id = new_id("res")
    file = unpublished.store("result", path, result_id, path.suffix)
    return Output(
        result_id=result_id,
        position=look.position,
        key=file.key,
        sha256=file.sha256,
        size_bytes=file.size_bytes,
        content_type=content_type_of(path.suffix),
        filename=filename,
        report=report,
        part_of=part_of,
    )


def _stem(medium: Media) -> str:
    return Path(medium.filename).stem[:80] if medium.filename else medium.id
