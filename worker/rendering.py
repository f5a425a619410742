"""A transfer or swap job: assets -> looks -> results. Nothing is ever vectorised here."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from service.catalog import IMAGE_CONTAINERS, Extra, Look, Media, OutputOptions, Report, look_params, render_request
from worker.answers import LookAnswer, RenderAnswer, checked, made
from worker.failures import OptionError
from worker.needed import asset_of, made_since, telling_what_is_lost, wanted
from worker.publishing import DrawnExtra, DrawnLook, publish
from worker.run import Run
from worker.sandbox import CrashError

#: parts of one video's share of the job: finding the new colours, drawing, extras; storing takes the rest
_TRANSFER, _RENDER = 0.05, 0.97
#: where drawing ends when there are extras: a matte is another reading of the clip for each look, a cube one frame
_RENDER_BEFORE = {"cube": 0.93, "matte": 0.6}


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
    assets = {media_id: asset_of(run, stack, present[media_id]) for media_id in media_ids}
    remade = made_since(run, [present[media_id] for media_id in media_ids])
    arguments = {
        "source": str(source),
        "asset": str(assets[video.id]),
        "remade": [str(assets[media_id]) for media_id in sorted(remade)],
        "looks": [{"reference": str(assets[look.reference_id]), "params": asdict(look_params(look))} for look in group],
        "output": asdict(render_request(run.job).output),
    }
    return arguments, [source, *assets.values()]


def drawn_look(look: Look, path: Path, said: LookAnswer, extras: Path) -> DrawnLook:
    """What was drawn, with what its process says of it."""
    report = Report(
        mask=said.mask,
        matching=said.matching,
        input_color=said.input_color,
        warnings=(*said.warnings, *(f"output: {line}" for line in said.output_warnings)),
    )
    files = [DrawnExtra(extra.part, extra.person, made(extras, extra.name)) for extra in said.extras]
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
