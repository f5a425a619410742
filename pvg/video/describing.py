"""What a clip's file holds and what a new clip would keep of it, told before any work."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pvg.video.images import IMAGE_SUFFIXES
from pvg.video.info import MediaInfo, probe
from pvg.video.keeping import make_plan
from pvg.video.opening import MediaLimits
from pvg.video.picture_metadata import lost_in_picture
from pvg.video.plan import Plan
from pvg.video.streams import Chapter, Streams, Track, read_streams


def planned(
    path: str | Path,
    *,
    container: str = "mp4",
    codec: str = "auto",
    audio: Literal["copy", "none"] = "copy",
    input_color: str = "auto",
    strict: bool = False,
    limits: MediaLimits | None = None,
) -> Plan:
    """The plan of a clip that is made from the one at `path`, see `make_plan` and `probe`.

    Raises MediaError for a file that is no clip, ValueError for what cannot be written so.
    """
    info = probe(path, limits, input_color=input_color, strict=strict)
    return make_plan(
        info, container=container, codec=codec, source=path, streams=read_streams(path, limits), audio=audio
    )


def inspect(
    path: str | Path,
    *,
    container: str | None = None,
    codec: str = "auto",
    audio: Literal["copy", "none"] = "copy",
    input_color: str = "auto",
    strict: bool = False,
    limits: MediaLimits | None = None,
) -> dict[str, Any]:
    """What the file of a clip or picture holds, and what an output of it keeps: JSON values.

    container, codec, audio: of the output, as `render` takes them; None is "mp4", or "png" for a picture. input_color,
    strict: see `probe`. "media" is as that tells it, in pixels, seconds and code points of ISO/IEC 23091-2, what is
    not read as "warnings"; "streams" lists what else is in a clip; "output" has the lines "kept", "changed" and
    "not_kept", or "refused", why there can be none. Raises MediaError as `probe`.
    """
    info = probe(path, limits, input_color=input_color, strict=strict)
    found: dict[str, Any] = {"media": _media(info)}
    if info.kind == "image":
        asked = {"container": container or "png"}
        if f".{asked['container']}" not in IMAGE_SUFFIXES:
            return found | {"output": asked | {"refused": "a picture is written as png, tiff, jpg or webp"}}
        return found | {"output": asked | {"not_kept": list(lost_in_picture(path, f"output.{asked['container']}"))}}
    streams = read_streams(path, limits)
    found["streams"] = _streams(streams)
    asked = {"container": container or "mp4", "codec": codec}
    try:
        plan = make_plan(info, container=asked["container"], codec=codec, source=path, streams=streams, audio=audio)
    except ValueError as error:
        return found | {"output": asked | {"refused": str(error)}}
    said = {"kept": list(plan.kept), "changed": list(plan.changed), "not_kept": list(plan.dropped)}
    return found | {"output": asked | {"codec": plan.codec, "width": plan.width, "height": plan.height} | said}


def _media(info: MediaInfo) -> dict[str, Any]:
    return {
        "kind": info.kind,
        "width": info.width,
        "height": info.height,
        "frame_rate": None if info.frame_rate is None else round(float(info.frame_rate), 3),
        "frame_count": info.frame_count,
        "duration_s": round(info.duration_s, 3),
        "codec": info.codec,
        "pixel_format": info.pixel_format,
        "color_primaries": info.color_primaries,
        "color_transfer": info.color_transfer,
        "color_matrix": info.color_matrix,
        "color_range": info.color_range,
        "rotation": info.rotation,
        "color": info.color,
        "alpha": info.has_alpha,
        "warnings": list(info.warnings),
    }


def _streams(streams: Streams) -> dict[str, Any]:
    mastering, light = streams.mastering, streams.light
    return {
        "tracks": [_track(track) for track in streams.tracks],
        "chapters": [_chapter(chapter) for chapter in streams.chapters],
        "metadata": dict(streams.metadata),
        "location_tags": list(streams.location),
        "timecode": streams.timecode,
        "fields": streams.fields,
        "alpha": streams.alpha,
        "mastering_display": None if mastering is None else mastering.integral(),
        "content_light_level": None if light is None else [light.max_content, light.max_average],
        "inside_the_pictures": list(streams.embedded),
    }


def _track(track: Track) -> dict[str, Any]:
    shown = {"index": track.index, "kind": track.kind, "codec": track.codec, "language": track.language}
    return shown | {"title": track.title or track.handler, "marks": list(track.dispositions)}


def _chapter(chapter: Chapter) -> dict[str, Any]:
    return {
        "start_s": round(float(chapter.start_s), 3),
        "end_s": round(float(chapter.end_s), 3),
        "title": chapter.title,
    }
