"""A long render in parts: cut by the worker that takes the job, drawn by any, joined by one.

Where parts begin follows from the clip and `Settings.part_s` alone, so that one worker and many give the same bytes.
What stays in one piece: pictures, clips shorter than two parts, and jobs with a matte, which is another reading of the
whole clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from pvg._bounds import part_bounds  # not pvg.rendering: the supervisor loads no method
from service.catalog import Look, Media, Message, parts, render_request
from service.catalog.parts import Drawn, NewFile, NewPart
from service.storage import BlobMissingError
from worker.answers import JoinAnswer, PartAnswer, checked, made
from worker.failures import LostPartsError
from worker.lease import LeaseLostError
from worker.needed import telling_what_is_lost, wanted
from worker.publishing import DrawnLook, publish
from worker.rendering import drawn_look, inputs, render, suffix_of
from worker.run import Run
from worker.sandbox import MethodError
from worker.unpublished import Unpublished

#: of a part: finding the new colours, drawing; storing takes the rest
_SPANS: Final = {"transfer": (0.0, 0.05), "render": (0.05, 0.99)}
_JOIN_SPANS: Final = {"join": (0.0, 0.97)}
#: the timings of parts that are shown as those of the job, added up
_SHOWN: Final = ("transfer_s", "render_s", "store_s", "cpu_s")


def render_or_split(run: Run) -> bool:
    """Do a transfer or swap in one piece, or leave it to be done in parts. False when its lease was lost."""
    looks, present = wanted(run)
    planned = _planned(run, looks, present)
    if not planned:
        return render(run)
    messages = run.patience(lambda: _split(run, planned))
    run.messages += messages or ()
    return messages is not None


def _planned(run: Run, looks: Sequence[Look], present: dict[str, Media]) -> list[NewPart]:
    """The parts; none when the job stays in one piece."""
    output = render_request(run.job).output
    videos = [present[video_id] for video_id in dict.fromkeys(look.video_id for look in looks)]
    if "matte" in output.extras or any((video.info or {}).get("kind") != "video" for video in videos):
        return []
    planned = []
    for video in videos:
        suffix_of(video, output)  # raises for a container that does not fit
        info = video.info or {}
        between = part_bounds(info["frame_count"], info["frame_rate"], part_s=run.settings.part_s)
        planned += [NewPart(video.id, start, stop) for start, stop in pairwise(between)]
    return planned if len(planned) > len(videos) else []


def _split(run: Run, planned: Sequence[NewPart]) -> list[Message] | None:
    with run.database.write() as session:
        return parts.split(session, run.lease, planned, now=run.database.now(), timings=run.timings)


def draw_part(run: Run) -> bool:
    """Draw a part of all looks of its video. False when its lease was lost."""
    part = run.read(lambda session: parts.get(session, run.job.id))
    if part is None:  # its job has ended
        raise LeaseLostError
    looks, present = wanted(run)
    video, group = present[part.video_id], [look for look in looks if look.video_id == part.video_id]
    run.progress.expect(_SPANS)
    folder = run.draft_folder()
    names = [f"look-{number}.part" for number in range(len(group))]
    with telling_what_is_lost(run, present), ExitStack() as stack:
        arguments, read = inputs(run, stack, video, group, present)
        arguments |= _coding(run, video) | {
            "paths": [str(folder / name) for name in names],
            "start": part.start,
            "stop": part.stop,
        }
        answer = checked(PartAnswer, run.call("render_part", arguments, read=read, folder=folder))
    run.add_timings(answer.timings.items())
    with Unpublished(run) as unpublished:
        stem, files = unpublished.own(run.job.id), []
        with run.timed("store_s"):
            for look, name in zip(group, names, strict=True):
                file = unpublished.store("drawn", made(folder, name), f"{stem}-{look.position}", ".part")
                files.append(NewFile(look.position, file.key, file.size_bytes))
        messages = unpublished.record(lambda: _finish(run, files))
    run.messages += messages or ()
    return messages is not None


def _coding(run: Run, video: Media) -> dict[str, Any]:
    """Of the clip that parts of a video are for."""
    return {"container": suffix_of(video, render_request(run.job).output).removeprefix(".")}


def _finish(run: Run, files: Sequence[NewFile]) -> list[Message] | None:
    with run.database.write() as session:
        messages = parts.finish(session, run.lease, files, now=run.database.now(), timings=run.timings)
        if messages is None and parts.is_finished(session, run.job.id, files):  # by a call whose answer was lost
            return []
        return messages


def join(run: Run) -> bool:
    """Make the results of the parts, and end the whole job. False when its lease was lost."""
    whole_id = run.job.parent_id
    assert whole_id is not None  # noqa: S101 - every job of this kind has one
    pieces = run.read(lambda session: parts.drawn(session, whole_id))
    if not pieces:  # the job has ended
        raise LeaseLostError
    looks, present = wanted(run)
    _take_timings(run, whole_id, pieces)
    run.progress.expect(_JOIN_SPANS)
    drawn: list[DrawnLook] = []
    with telling_what_is_lost(run, present):
        for number, look in enumerate(looks):
            run.progress("join", number, len(looks))
            files = [piece.files[look.position] for piece in pieces if piece.video_id == look.video_id]
            drawn.append(_join_look(run, look, files, present))
    run.progress("join", len(looks), len(looks))
    published = publish(run, drawn, present)
    if published:
        run.blobs.delete([key for piece in pieces for key in piece.files.values()])
    return published


def _take_timings(run: Run, whole_id: str, pieces: Sequence[Drawn]) -> None:
    """Those of the whole so far: they are recorded with its end."""
    run.timings.clear()
    run.add_timings(run.read(lambda session: parts.timings_of(session, whole_id)).items())
    for piece in pieces:
        run.add_timings((name, piece.timings[name]) for name in _SHOWN if name in piece.timings)


def _join_look(run: Run, look: Look, files: Sequence[str], present: dict[str, Media]) -> DrawnLook:
    """One look as a file, in a process of its own."""
    video = present[look.video_id]
    folder = run.draft_folder()
    name, extras = f"look{suffix_of(video, render_request(run.job).output)}", folder / "extras"
    with ExitStack() as stack:
        arguments, read = inputs(run, stack, video, [look], present)
        drawn = [_file(run, stack, key) for key in files]
        arguments |= _coding(run, video) | {
            "paths": [str(folder / name)],
            "parts": [[str(path) for path in drawn]],
            "extras": [str(extras)],
        }
        try:
            answer = checked(JoinAnswer, run.call("join", arguments, read=[*read, *drawn], folder=folder))
        except MethodError as error:
            if error.kind == "PartError":
                raise LostPartsError(str(error)) from error
            raise
    run.add_timings(answer.timings.items())
    return drawn_look(look, made(folder, name), answer.looks[0], extras)


def _file(run: Run, stack: ExitStack, key: str) -> Path:
    try:
        return stack.enter_context(run.local_path(key))
    except BlobMissingError as error:
        raise LostPartsError(f"{key} is no longer in the storage") from error
