"""All work on media, in the process of one job: the only part of the worker that uses the method.

Arguments come from the supervisor, and so can be trusted; the files they name cannot.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import cv2

import pvg
from pvg import memory, models
from pvg._arrays import Bytes
from pvg.asset import VectorVideo
from pvg.errors import AssetError, TooLargeError
from pvg.looks import reference_face_of
from pvg.rendering import Stills, around, cropped, encoded, fitted, join_parts, render, render_part
from pvg.vectorization import VECTORIZER_VERSION, vectorize
from pvg.video import MediaLimits, inspect, planned, probe
from pvg.warmup import warm_up
from worker.sandbox.faults import fault_of

Progress = Callable[[str, int, int], None]

#: longest side of a medium's poster, side of a face's thumbnail, and how many faces have one: the widest
POSTER_PX: Final = 640
THUMBNAIL_PX: Final = 160
MOST_THUMBNAILS: Final = 100


class OptionError(Exception):
    """An option of the request does not fit the medium it is used on."""


class AbsentFaceError(OptionError):
    """The face that is to be shown alone is not in the frame."""


def preload() -> None:
    """Load all that the calls need, once for all jobs, without starting a thread: threads do not survive a fork."""
    cv2.setNumThreads(1)
    warm_up()
    models.preload()


def begin() -> None:
    """After the fork, in the process of a job."""
    cv2.setNumThreads(int(os.environ.get("OPENCV_FOR_THREADS_NUM", "1")))


def _vectorize(arguments: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Vectorise ``source`` into ``asset`` with ``options``; its summary, and what a result will not keep of it."""
    source, limits = Path(arguments["source"]), _limits(arguments)
    options = arguments["options"]
    media = probe(source, limits, input_color=options["input_color"])
    needed = memory.vectorizing_bytes(media)
    if not options["reference"]:  # what cannot be drawn later is not taken now
        needed = max(needed, memory.rendering_bytes(media, 1))
    _check_memory(media, needed, arguments["memory_bytes"])
    with vectorize(source, asset=arguments["asset"], limits=limits, progress=progress, **options) as video:
        summary = video.summary()
        seen, pictures = _show(Stills(video), Path(arguments["pictures"]))
    return {
        "media": summary["media"],
        "faces": [
            {**{name: face[name] for name in _SHOWN}, **seen.get(face["index"], {"frame": None, "box": None})}
            for face in summary["faces"]
        ],
        "pictures": pictures,
        "output": None if options["reference"] else _output_of(source, limits, options["input_color"]),
    }


def _limits(arguments: Mapping[str, Any]) -> MediaLimits:
    """What a clip must keep whenever it is read, by the settings."""
    return MediaLimits(**arguments["limits"])


def _show(stills: Stills, path: Path) -> tuple[dict[int, dict[str, Any]], list[dict[str, Any]]]:
    """Write a poster and a thumbnail of each face into one file; where each face is seen, and where each picture is."""
    frame = stills.usual_frame()
    shown: dict[int | None, Bytes] = {None: fitted(stills.drawn(None, frame), POSTER_PX, POSTER_PX)}
    widest = sorted(stills.video.faces, key=lambda face: face.width_px, reverse=True)[:MOST_THUMBNAILS]
    seen = {}
    for one in stills.seen_faces([face.index for face in widest], THUMBNAIL_PX):
        shown[one.index] = one.picture
        seen[one.index] = {"frame": one.frame, "box": list(one.box)}
    pictures, start = [], 0
    with path.open("wb") as file:
        for face, picture in shown.items():
            file.write(encoded(picture, "jpeg"))
            pictures.append({"face": face, "start": start, "end": file.tell()})
            start = file.tell()
    return seen, pictures


_SHOWN = ("index", "first_frame", "last_frame", "width_px", "skin_rgb", "warnings")


def _output_of(source: Path, limits: MediaLimits, input_color: str) -> dict[str, Any]:
    """What an mp4 made of a clip, or a png of a picture, does not keep of its file, or why there can be none."""
    output = inspect(source, limits=limits, input_color=input_color)["output"]
    lost = [*output.get("changed", ()), *output.get("not_kept", ())]
    return {"container": output["container"], "refused": output.get("refused"), "lost": lost}


def _check_memory(media: Any, needed: int, budget: int) -> None:
    if needed > budget:
        what = "picture" if media.kind == "image" else "clip"
        raise TooLargeError(
            f"a {what} of {media.width}x{media.height} ({media.pixel_format or 'RGB'}) needs {needed / 1e9:.1f} GB of "
            f"memory; a job may take {budget / 1e9:.1f} GB: scale it down, or raise PVG_JOB_MEMORY_BYTES",
            budget,
            "bytes of memory",
        )


def _render(arguments: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Draw the ``looks`` of one clip or picture into ``paths``, and the extras of each into a folder of ``extras``."""
    timings: dict[str, float] = {}
    with ExitStack() as stack:
        video, looks, reports = _open(stack, arguments, progress, timings)
        with _timed(timings, "render_s"):
            lines = _draw(video, looks, arguments, progress)
        extras = _extras(video, looks, arguments, progress, timings)
    return {"looks": _answers(video, reports, lines, extras), "timings": timings}


def _open(
    stack: ExitStack, arguments: Mapping[str, Any], progress: Progress, timings: dict[str, float]
) -> tuple[VectorVideo, list[pvg.Look], list[dict[str, Any]]]:
    """The clip or picture, its looks, and what is to be known of each."""
    video = stack.enter_context(VectorVideo(arguments["asset"], arguments["source"], limits=_limits(arguments)))
    _check_vectorizer(video, arguments)
    looks, reports = [], []
    with _timed(timings, "transfer_s"):
        for done, wanted in enumerate(arguments["looks"]):
            progress("transfer", done, len(arguments["looks"]))
            reference = stack.enter_context(VectorVideo(wanted["reference"]))
            _check_vectorizer(reference, arguments)
            looks.append(_transfer(video, reference, wanted["params"]))
            reports.append(_report(video, reference, wanted["params"]))
    return video, looks, reports


def _check_vectorizer(video: VectorVideo, arguments: Mapping[str, Any]) -> None:
    """Raise `AssetError` for an asset that an earlier vectoriser made, unless it was ``remade`` for this job."""
    made_by = video.manifest.get("vectorizer")
    if str(video.path) not in arguments["remade"] and (not isinstance(made_by, int) or made_by < VECTORIZER_VERSION):
        raise AssetError(f"{video.path.name} was made by vectoriser {made_by}; this one is {VECTORIZER_VERSION}")


def _render_part(arguments: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Draw frames [``start``, ``stop``) of the ``looks`` of one clip into ``paths``, to be joined by `_join`."""
    timings: dict[str, float] = {}
    with ExitStack() as stack:
        video, looks, _ = _open(stack, arguments, progress, timings)
        options = _coding(video, arguments)
        where = {name: arguments[name] for name in ("start", "stop", "memory_bytes")}
        with _timed(timings, "render_s"), _options_that_fit():
            render_part(video, looks, arguments["paths"], **where, **options, progress=progress)
    return {"timings": timings | {"cpu_s": round(time.process_time(), 3)}}


def _join(arguments: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Make a clip of each look of its ``parts`` into ``paths``, and its cubes into a folder of ``extras``."""
    timings: dict[str, float] = {}
    with ExitStack() as stack:
        video, looks, reports = _open(stack, arguments, lambda *_: None, timings)
        options = _coding(video, arguments) | {"audio": arguments["output"]["audio"]}
        with _timed(timings, "join_s"), _options_that_fit():
            lines = join_parts(video, arguments["parts"], arguments["paths"], **options)
        extras = _extras(video, looks, arguments, lambda *_: None, timings)
    return {
        "looks": _answers(video, reports, lines, extras),
        "timings": timings | {"cpu_s": round(time.process_time(), 3)},
    }


def _coding(video: VectorVideo, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """How parts of a clip are coded. Raises `TooLargeError` for a clip that a job cannot take."""
    output = arguments["output"]
    _check_drawing(video, arguments["container"], arguments)
    return {"container": arguments["container"], **{name: output[name] for name in ("codec", "crf", "preset")}}


def _check_drawing(video: VectorVideo, container: str, arguments: Mapping[str, Any]) -> None:
    """Raise `TooLargeError` where drawing would need more memory than a job may take, `OptionError` for no codec."""
    source, color, codec = video.require_source(), video.settings["input_color"], arguments["output"]["codec"]
    media = probe(source, video.limits, input_color=color)
    at_once = len(arguments["looks"])
    if media.kind != "image":
        at_once = 1  # more passes are made
        with _options_that_fit():
            plan = planned(source, container=container, codec=codec, input_color=color, limits=video.limits)
        codec = plan.codec
    _check_memory(media, memory.rendering_bytes(media, at_once, codec), arguments["memory_bytes"])


def _answers(
    video: VectorVideo,
    reports: list[dict[str, Any]],
    lines: list[tuple[str, ...]],
    extras: list[list[dict[str, Any]]],
) -> list[dict[str, Any]]:
    """What is told of each look: what is to be known, what is not as in the clip, what was made beside it."""
    # of the ``lines``, those of the file itself come first
    unread = probe(video.require_source(), video.limits, input_color=video.settings["input_color"]).warnings
    of_video = [f"video: {line}" for line in unread]
    return [
        {
            **report,
            "warnings": of_video + report["warnings"],
            "output_warnings": [line for line in changed if line not in unread],
            "extras": made,
        }
        for report, changed, made in zip(reports, lines, extras, strict=True)
    ]


def _draw(
    video: VectorVideo, looks: list[pvg.Look], arguments: Mapping[str, Any], progress: Progress
) -> list[tuple[str, ...]]:
    """Draw the looks into ``paths``; for each what is not as in the clip or picture, a line each."""
    output, budget = arguments["output"], arguments["memory_bytes"]
    _check_drawing(video, Path(arguments["paths"][0]).suffix, arguments)
    options = {name: output[name] for name in ("codec", "crf", "preset", "audio")}
    with _options_that_fit():
        return render(video, looks, arguments["paths"], **options, memory_bytes=budget, progress=progress)


def _transfer(video: VectorVideo, reference: VectorVideo, params: Mapping[str, Any]) -> pvg.Look:
    options: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in params.items()
    }
    with _options_that_fit():
        if options.pop("exchange"):
            del options["reference_face"]
            return pvg.exchange(video, **options)
        return pvg.transfer(video, reference, **options)


def _report(video: VectorVideo, reference: VectorVideo, params: Mapping[str, Any]) -> dict[str, Any]:
    """How the video was vectorised, and the warnings of the faces that take part."""
    warnings = [
        f"video, face {face.index}: {warning}"
        for face in video.faces
        if params["faces"] == "all" or face.index in params["faces"]
        for warning in face.warnings
    ]
    if not params["exchange"]:
        face = reference_face_of(reference, params["reference_face"])
        warnings += [f"reference, face {face.index}: {warning}" for warning in face.warnings]
    return {**{name: video.settings[name] for name in ("mask", "matching", "input_color")}, "warnings": warnings}


def _extras(
    video: VectorVideo,
    looks: list[pvg.Look],
    arguments: Mapping[str, Any],
    progress: Progress,
    timings: dict[str, float],
) -> list[list[dict[str, Any]]]:
    """What is made beside each look, as `_export` tells of it: nothing where nothing is asked for."""
    if not arguments["output"]["extras"]:
        return [[] for _ in looks]
    with _timed(timings, "extras_s"):
        return _export(video, looks, arguments, progress)


def _export(
    video: VectorVideo, looks: list[pvg.Look], arguments: Mapping[str, Any], progress: Progress
) -> list[list[dict[str, Any]]]:
    """The cubes and mattes of each look, one for each person that it changes: part, person and name in its folder.

    Mattes are drawn once for all looks that have the same ones.
    """
    output, count, made = arguments["output"], len(looks), []
    drawn_mattes: dict[Hashable, list[Path]] = {}
    for number, (look, folder) in enumerate(zip(looks, arguments["extras"], strict=True)):

        def drawn(_: str, done: int, frames: int, number: int = number) -> None:
            progress("extras", number * frames + done, count * frames)

        alike = drawn_mattes.get(look.matte_key)
        parts = [part for part in output["extras"] if part != "matte" or alike is None]
        with _options_that_fit():
            written = pvg.export(video, look, folder, parts=parts, matte=output["matte"], progress=drawn)
        cubes = [path for path in written if path.suffix == ".cube"]
        mattes = [path for path in written if path.stem.startswith("matte")]
        if alike is not None:
            mattes = [Path(shutil.copyfile(path, Path(folder) / path.name)) for path in alike]
        drawn_mattes[look.matte_key] = mattes
        made.append(
            [
                {"part": part, "person": person, "name": path.name}
                for part, paths in (("look.cube", cubes), ("matte", mattes))
                for person, path in enumerate(paths, 1)
            ]
        )
        progress("extras", video.frame_count * (number + 1), video.frame_count * count)
    return made


@contextmanager
def _options_that_fit() -> Iterator[None]:
    """Raise `OptionError` where the method refuses an option."""
    try:
        yield
    except ValueError as error:
        raise OptionError(str(error)) from error


@contextmanager
def _timed(timings: dict[str, float], name: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    timings[name] = round(time.perf_counter() - began, 3)


def _verify(arguments: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Whether ``asset`` can be read, every byte of it, and no earlier vectoriser made it, see `_check_vectorizer`.

    Raises `AssetError` where that cannot be told, as its disk does not answer.
    """
    try:
        with VectorVideo(arguments["asset"]) as video:
            _check_vectorizer(video, arguments)
            video.verify()
    except AssetError as error:
        if fault_of(error) == "certain":
            raise
        return {"usable": False}
    return {"usable": True}


def _open_stills(arguments: Mapping[str, Any]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Open a clip, and a reference for it if there is one, and answer with pictures of single frames."""
    video = VectorVideo(arguments["asset"], arguments["source"], limits=_limits(arguments))
    reference = None if arguments["reference"] is None else VectorVideo(arguments["reference"])
    stills = Stills(video)

    def answer_to(question: Mapping[str, Any]) -> dict[str, Any]:
        with _options_that_fit():
            index = _frame_of(stills, question)
            if question["layer"] is not None:
                rgb = stills.layer(index, question["layer"])
            else:
                look = None
                if reference is not None and question["params"] is not None and not question["before"]:
                    look = _transfer(video, reference, question["params"])
                rgb = stills.drawn(look, index)
            box = question["crop"]
            if question["face"] is not None:
                box = around(_face_box(stills, question["face"], index))
            rgb = fitted(cropped(rgb, box), question["max_width"])
        Path(question["path"]).write_bytes(encoded(rgb, question["format"]))
        return {"frame": index, "width": rgb.shape[1], "height": rgb.shape[0]}

    return answer_to


def _face_box(stills: Stills, face: int, index: int) -> tuple[int, int, int, int]:
    """Raise `AbsentFaceError` where the frame does not show the face."""
    try:
        return stills.face_box(face, index)
    except ValueError as error:
        raise AbsentFaceError(str(error)) from error


def _frame_of(stills: Stills, question: Mapping[str, Any]) -> int:
    """The frame that is asked for, or where none is, one that shows the faces that the look changes."""
    index = question["frame"]
    if question["time_s"] is not None:
        index = stills.at_time(question["time_s"])
    if index is None:
        params, face = question["params"] or {}, question["face"]
        chosen = params.get("faces", "all")
        if face is not None:
            chosen = [face]
        index = stills.usual_frame(None if chosen == "all" else chosen)
    return stills.nearest(index) if question["nearest"] else int(index)


#: what stays for a while with a clip open
SESSIONS: Mapping[str, Callable[[Mapping[str, Any]], Callable[[Mapping[str, Any]], dict[str, Any]]]] = {
    "stills": _open_stills,
}
CALLS: Mapping[str, Callable[[Mapping[str, Any], Progress], dict[str, Any]]] = {
    "vectorize": _vectorize,
    "render": _render,
    "render_part": _render_part,
    "join": _join,
    "verify": _verify,
}
