"""What a clip's looks are drawn on and where they go: a file or a pipe on either side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO, Literal

from pvg._checks import check_word
from pvg.asset import VectorVideo
from pvg.errors import AssetError, MediaError
from pvg.video import (
    CLIP_SUFFIXES,
    CONTAINERS,
    IMAGE_SUFFIXES,
    PIPED,
    DisplayOrder,
    Frame,
    MediaInfo,
    PipedClip,
    PipeReader,
    Plan,
    Streams,
    VideoWriter,
    Y4mWriter,
    check_scales,
    color_space,
    display_order,
    make_plan,
    named_space,
    probe,
    read_frames,
    read_streams,
)


@dataclass(frozen=True)
class Encoding:
    """How outputs are encoded, as `render` is told."""

    container: str | None = None
    codec: str = "auto"
    crf: int | None = None
    preset: str | None = None
    audio: Literal["copy", "none"] = "copy"

    def __post_init__(self) -> None:
        """Raise ValueError for an option that no output takes, neither a clip nor a picture."""
        check_word("audio", self.audio, ("copy", "none"))
        check_scales(self.codec, self.crf, self.preset)


@dataclass(frozen=True)
class Canvas:
    """The pictures that are drawn on, and the file whose other streams go along; None without one.

    frames: gives all of them, of a file each time it is called, of a pipe once;  missing: what cannot go along, in
    words.
    """

    info: MediaInfo
    source: Path | None
    streams: Streams
    frames: Callable[[], Iterator[Frame]]
    missing: tuple[str, ...] = ()


def stored_canvas(video: VectorVideo) -> Canvas:
    """A clip's or picture's own file. Raises `AssetError` where it is missing, another, or not vectorised in full."""
    check_in_full(video)
    source = video.require_source()
    info = probe(source, video.limits, input_color=video.settings["input_color"])
    streams = read_streams(source, video.limits) if info.kind == "video" else Streams()
    return Canvas(info, source, streams, lambda: stored_frames(video))


def stored_frames(video: VectorVideo, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
    """The frames [start, stop) of a clip's or picture's own file, read as when it was vectorised.

    Raises as `stored_canvas`.
    """
    check_in_full(video)
    return frames_of_file(video, start, stop)


def frames_of_file(video: VectorVideo, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
    """As `stored_frames`, of a reference's clip too. Raises `AssetError` where the file is missing or another one."""
    source, color, count = video.require_source(), video.settings["input_color"], count_of_file(video)
    return read_frames(source, start=start, stop=stop, limits=video.limits, input_color=color, frame_count=count)


def frame_of_file(video: VectorVideo, index: int) -> Frame:
    """Frame `index` of a clip's or picture's own file, a reference's too, for whoever may ask for others.

    Raises `ValueError` where there is none, `AssetError` as `frames_of_file`, `MediaError` when it cannot be read.
    """
    check_index(video, index)
    source, color, count = video.require_source(), video.settings["input_color"], count_of_file(video)
    found = video.single_frames.frame(source, index, limits=video.limits, input_color=color, frame_count=count)
    frame = found or next(frames_of_file(video, index, index + 1), None)
    if frame is None:
        raise MediaError(f"{video.path.name}: frame {index} of its clip cannot be read")
    return frame


def count_of_file(video: VectorVideo) -> int | None:
    """How many frames the file has; None for a reference's clip, of which only the beginning was read."""
    return None if video.settings["reference"] else video.frame_count


def check_index(video: VectorVideo, index: int) -> None:
    """Raise `ValueError` when a clip has no frame `index`."""
    if not 0 <= index < video.frame_count:
        raise ValueError(f"no frame {index}; the clip has {video.frame_count}")


def check_in_full(video: VectorVideo) -> None:
    """Raise `AssetError` for a reference's clip, of which only a key frame is kept."""
    if video.settings["reference"] and video.media.kind == "video":
        raise AssetError(
            f"{video.path.name} keeps a reference's key frame only; vectorise the clip in full to render it"
        )


@contextmanager
def piped_canvas(video: VectorVideo, pictures: BinaryIO) -> Iterator[Canvas]:
    """Pictures that come by a pipe, once, in the place of those of `video`.

    Colours and times that the pipe leaves unsaid are the clip's, as far as its file is there and tells them. Raises
    MediaError when size or number of the pictures differ.
    """
    source = None if video.source is None else video.require_source()
    media, input_color = video.media, video.settings["input_color"]
    known = None if source is None else probe(source, video.limits, input_color=input_color)
    told = None if known is None or known.format.is_rgb else known  # R, G, B tell nothing of luma and chroma
    color = (2, 0) if told is None else (told.color_matrix, told.color_range)
    tags = media.color_primaries, media.color_transfer
    space = color_space(*tags) if input_color == "auto" else named_space(input_color)
    with PipeReader(pictures, color, space, video.limits) as clip:
        if (clip.width, clip.height) != (media.width, media.height):
            raise MediaError(
                f"{clip.name} is {clip.width}x{clip.height}; {video.path.name} is of a clip of "
                f"{media.width}x{media.height}"
            )
        streams = Streams() if source is None else read_streams(source, video.limits)
        # what says how pictures were coded is the pipe's
        fields = clip.fields if clip.fields or clip.progressive else streams.fields
        streams = replace(streams, fields=fields, alpha=False, embedded=())
        order = start_s = None
        if source is not None and not clip.stamped:  # beside its sound
            order = display_order(source, video.limits, video.frame_count)
        elif source is not None and known is not None and known.time_base is not None:
            # NUT has no time before zero: all is moved where the sound begins so
            first = next(read_frames(source, stop=1, limits=video.limits, input_color=input_color))
            start_s = first.pts * known.time_base
        info, missing = _info(clip, known, order, video), _missing(clip, known, order)
        yield Canvas(info, source, streams, lambda: _counted(clip, order, start_s, video), missing)


def _missing(clip: PipedClip, known: MediaInfo | None, order: DisplayOrder | None) -> tuple[str, ...]:
    """What of a clip a pipe does not bring, in words;  known, order: of its file, where it is there and tells them."""
    if known is None:
        what = "sound and tags" if clip.stamped else "sound, tags and time stamps"
        return (f"{what} do not come by the pipe, and the clip is not there",)
    lines = []
    if known.has_alpha and not clip.has_alpha:
        lines.append("alpha does not come by the pipe")
    if order is None and not clip.stamped:
        lines.append(
            "time stamps do not come by the pipe, nor does the clip tell them: they become even beside its sound"
        )
    return tuple(lines)


def _info(clip: PipedClip, known: MediaInfo | None, order: DisplayOrder | None, video: VectorVideo) -> MediaInfo:
    timed = None if order is None else known
    rate = clip.frame_rate if timed is None else timed.frame_rate or clip.frame_rate
    return MediaInfo(
        kind="video",
        width=clip.width,
        height=clip.height,
        frame_rate=rate,
        time_base=clip.time_base if order is None else order.time_base,
        frame_count=video.frame_count,
        duration_s=float(video.frame_count / rate),
        codec="",
        pixel_format=clip.pixel_format,
        color_matrix=2 if known is None else known.color_matrix,
        color_range=(2 if clip.format.full_range else 1) if known is None else known.color_range,
        color_primaries=video.media.color_primaries,
        color_transfer=video.media.color_transfer,
        rotation=0,
        has_audio=known is not None and known.has_audio,
        audio_codec=None,
        format=clip.format,
        sample_aspect_ratio=clip.sample_aspect_ratio if known is None else known.sample_aspect_ratio,
        has_alpha=clip.has_alpha,
        even_rate=None if timed is None else timed.even_rate,
    )


def _counted(
    clip: PipedClip, order: DisplayOrder | None, start_s: Fraction | None, video: VectorVideo
) -> Iterator[Frame]:
    """The pipe's frames, shown when the clip shows its own; start_s: when that is of the first one, None for any."""
    count = shift = 0
    for frame in clip.frames:
        if start_s is not None and count == 0:
            shift = round(start_s / clip.time_base) - frame.pts
        count += 1
        if count > video.frame_count:
            raise MediaError(f"{clip.name} has more frames than the {video.frame_count} of {video.path.name}")
        yield _moved(frame, shift, clip.time_base) if order is None else _shown(frame, order)
    if count < video.frame_count:
        raise MediaError(f"{clip.name} ends after {count} frames; {video.path.name} has {video.frame_count}")


def _moved(frame: Frame, shift: int, time_base: Fraction) -> Frame:
    return replace(frame, pts=frame.pts + shift, time_s=float((frame.pts + shift) * time_base)) if shift else frame


def _shown(frame: Frame, order: DisplayOrder) -> Frame:
    """The frame when the clip shows its own of that number; how long the last one lasts is left to the frame rate."""
    pts, following = order.stamps[frame.index], order.stamps[frame.index + 1 : frame.index + 2]
    duration = following[0] - pts if following else 0
    return replace(frame, pts=pts, time_s=float(pts * order.time_base), duration=duration)


def plans_of(targets: Sequence[Path | BinaryIO], canvas: Canvas, encoding: Encoding) -> list[Plan]:
    """The plan of each output. Raises ValueError for what cannot be written so."""
    made: dict[str, Plan] = {}
    plans = []
    for target in targets:
        key = _container(target, encoding.container)
        if key not in made:
            plan = make_plan(
                canvas.info,
                container=key,
                codec=encoding.codec,
                source=canvas.source,
                streams=canvas.streams,
                audio=encoding.audio,
            )
            check_scales(plan.codec, encoding.crf, encoding.preset)
            made[key] = replace(plan, dropped=plan.dropped + canvas.missing)
        plans.append(made[key])
    return plans


def check_picture(target: Path | BinaryIO, encoding: Encoding) -> None:
    """Raise ValueError for a picture that cannot be written so. It has no codec and no sound: these are of clips."""
    if not isinstance(target, Path):
        raise ValueError("a picture is written to a file")
    suffix = target.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        raise ValueError(f"{target.name}: a picture is written as {', '.join(sorted(IMAGE_SUFFIXES))}")
    named = {".tif": "tiff", ".jpeg": "jpg"}.get(suffix, suffix[1:])
    if encoding.container not in (None, named):
        raise ValueError(f"{target.name} is not named as {encoding.container} is")


def _container(target: Path | BinaryIO, container: str | None) -> str:
    if not isinstance(target, Path):
        if container not in (None, *PIPED):
            raise ValueError(f"{container} cannot be written to a pipe; {' and '.join(PIPED)} can")
        return container or "nut"
    suffix = target.suffix.lower()
    if container is not None:
        if suffix in CLIP_SUFFIXES and CONTAINERS.get(container) != CONTAINERS[suffix]:
            raise ValueError(f"{target.name} is not named as {container} is")
        return container
    if suffix not in CLIP_SUFFIXES:
        raise ValueError(f"{target.name}: a clip is written as .mp4, .mov, .mkv or .webm")
    return suffix


def writer_of(
    draft: Path | BinaryIO, info: MediaInfo, plan: Plan, encoding: Encoding, threads: int
) -> VideoWriter | Y4mWriter:
    """What carries out a plan; threads: of its encoder."""
    if plan.container == "y4m":
        if isinstance(draft, Path):
            raise ValueError("YUV4MPEG2 is written to a pipe")
        return Y4mWriter(draft, info, info.format, plan)
    return VideoWriter(draft, info, info.format, crf=encoding.crf, preset=encoding.preset, threads=threads, plan=plan)
