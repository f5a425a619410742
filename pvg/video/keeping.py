"""What of a clip's file goes into a new one: its plan is made here, and what is changed or not kept is put in words."""

from __future__ import annotations

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

import av

from pvg.video.containers import CONTAINER_FORMATS, CONTAINERS, PIPED, has_edits, label_of, short_name
from pvg.video.encoders import ENCODERS, choose_codec, encoded_size, encoder_format, holds_alpha
from pvg.video.formats import LUMA_WEIGHTS, UNSPECIFIED, UNSTATED, PixelFormat
from pvg.video.info import MediaInfo
from pvg.video.languages import language_in
from pvg.video.opening import StatedColors
from pvg.video.plan import Carried, Plan
from pvg.video.sound_formats import carry_sound
from pvg.video.streams import NO_STREAMS, Chapter, Streams, Track

_TEXT = ("mov_text", "srt", "ass", "webvtt", "text")

_TIMECODE = re.compile(r"-?\d\d:\d\d:\d\d([:;.])\d\d+$")
_CHROMA = {(0, 0): "4:4:4", (1, 0): "4:2:2", (2, 0): "4:1:1", (0, 1): "4:4:0", (1, 1): "4:2:0", (2, 2): "4:1:0"}
_COLORED = 3  # components
_BT709, _BT601 = 1, 6  # code points of ISO/IEC 23091-2: a transfer function; primaries and matrix
_WIDE = 64  # pixels of a side, to measure the chroma's by
_ASPECT_IN_STREAM = ("h264", "hevc")
"""Codecs that say a pixel's aspect in their pictures."""
_FIELD_LABELS = {"tff": "top field first", "bff": "bottom field first"}


class _Lines:
    """The words of a plan, as it is made."""

    def __init__(self) -> None:
        self.kept: list[str] = []
        self.changed: list[str] = []
        self.dropped: list[str] = []


def make_plan(
    info: MediaInfo,
    *,
    container: str,
    codec: str = "auto",
    source: str | Path | None = None,
    streams: Streams = NO_STREAMS,
    audio: Literal["copy", "none"] = "copy",
    pixel_format: PixelFormat | None = None,
) -> Plan:
    """Plan a clip that is made from another.

    info: the source clip's. container, codec: of the new one, see `choose_codec`. source: its file; streams: what that
    holds. audio: "none" leaves out all sound, which is not called a loss. pixel_format: of the frames to come, as
    `info` has it when None. Raises ValueError, in one line, for what cannot be written so.
    """
    if container not in CONTAINERS:
        raise ValueError(f"container {container!r} is not one of {', '.join(map(short_name, CONTAINER_FORMATS))}")
    if audio not in ("copy", "none"):
        raise ValueError(f"audio is copy or none, not {audio!r}")
    name = CONTAINERS[container]
    frames = pixel_format or info.format
    chosen = choose_codec(codec, name, frames.depth, interlaced=streams.fields is not None)
    if streams.fields is not None and info.rotation:
        raise ValueError("the clip is interlaced and turned: its fields cannot be kept upright; deinterlace it first")
    target = encoder_format(frames, chosen)
    size = encoded_size(info.width, info.height, target, chosen, interlaced=streams.fields is not None)
    least = ENCODERS[chosen].least
    if size[0] < least[0] or size[1] < least[1]:
        needs = f"; it needs {least[0]}x{least[1]}" if least != (1, 1) else ""
        raise ValueError(f"{info.width}x{info.height} is too small for {chosen} {target.name}{needs}")
    if name == "y4m" and target.is_rgb:
        raise ValueError("YUV4MPEG2 holds no R, G, B; write --container nut")
    lines = _Lines()
    _pictures(lines, info, frames, target, size, chosen)
    plan = Plan(name, chosen, target, *size, source=None if source is None else Path(source))
    plan = _with_picture_facts(plan, lines, info, streams)
    plan = _with_tracks(plan, lines, streams, audio)
    plan = _with_tags(plan, lines, info, streams)
    return replace(plan, kept=tuple(lines.kept), changed=tuple(lines.changed), dropped=tuple(lines.dropped))


def _pictures(
    lines: _Lines, info: MediaInfo, frames: PixelFormat, target: PixelFormat, size: tuple[int, int], codec: str
) -> None:
    name = ENCODERS[codec].label
    coded = av.VideoFormat(info.pixel_format if frames == info.format else frames.name)
    before, after = _coded_layout(coded, frames), _layout(target)
    if before == after:
        lines.kept.append(f"pictures: {after}")
    elif before == f"grey, {target.depth} bits":
        lines.kept.append(f"pictures: {before}, in {after}")
    else:
        why = "the nearest that looks are drawn in" if _layout(frames) == after else f"as {name} has it"
        lines.changed.append(f"pictures become {after} (the clip's are {before}), {why}")
    if frames.full_range and not target.full_range and not frames.is_rgb:
        lines.changed.append(f"full-range code values become studio range, {name}'s only one")
    if codec == "dnxhr" and not frames.is_rgb and stated_colors(info, codec) != stated_colors(info, "auto"):
        lines.changed.append(
            f"colour tags that the clip leaves out are written as BT.601's: {name} has BT.709 without them"
        )
    if size != (info.width, info.height):
        lines.changed.append(
            f"the size becomes {size[0]}x{size[1]} (the clip's is {info.width}x{info.height}): {name} has no odd ones"
        )


def stated_colors(info: MediaInfo, codec: str) -> StatedColors:
    """The colour tags of Y'CbCr pictures that are made from a clip's; the range is left open.

    What a clip does not say stays unsaid, and players go by the pictures' size. But DNxHR's are taken for BT.709 then,
    and MOV has no place for the matrix alone.
    """
    matrix = UNSPECIFIED if info.color_matrix in UNSTATED else info.color_matrix  # 0: that of an R, G, B clip
    primaries, transfer = info.color_primaries, info.color_transfer
    if codec == "dnxhr" and info.format.luma_weights == LUMA_WEIGHTS[_BT601]:
        matrix = _BT601 if matrix == UNSPECIFIED else matrix
        primaries = _BT601 if primaries in UNSTATED else primaries
        transfer = _BT709 if transfer in UNSTATED else transfer
    return StatedColors(primaries, transfer, matrix)


def _coded_layout(coded: av.VideoFormat, frames: PixelFormat) -> str:
    """The layout of the clip's own pictures in words, as `_layout`; frames: what they are read as."""
    depth = max(component.bits for component in coded.components)
    if frames.is_rgb:  # what has fewer bits loses none
        return f"R'G'B', {max(depth, frames.depth)} bits"
    if len(coded.components) < _COLORED:
        return f"grey, {depth} bits"
    shares = coded.chroma_width(_WIDE), coded.chroma_height(_WIDE)
    return f"Y'CbCr {_CHROMA[_WIDE // shares[0] // 2, _WIDE // shares[1] // 2]}, {depth} bits"


def _layout(pixel_format: PixelFormat) -> str:
    chroma = "R'G'B'" if pixel_format.is_rgb else f"Y'CbCr {_CHROMA[pixel_format.chroma_log2]}"
    return f"{chroma}, {pixel_format.depth} bits"


def _with_picture_facts(plan: Plan, lines: _Lines, info: MediaInfo, streams: Streams) -> Plan:
    """Alpha, fields, HDR metadata and what rides inside the pictures."""
    name = ENCODERS[plan.codec].label
    alpha = info.has_alpha and holds_alpha(plan.format, plan.codec, plan.container)
    if alpha:
        lines.kept.append("alpha")
    elif info.has_alpha:
        lines.dropped.append(f"alpha is not kept by {name}; prores4444 in .mov and ffv1 in .mkv keep it")
    if streams.fields is not None:
        lines.kept.append(f"fields: {_FIELD_LABELS[streams.fields]}")
    encoder = ENCODERS[plan.codec]
    for there, what in (
        (streams.mastering, "HDR10 mastering display metadata"),
        (streams.light, "HDR10 content light level"),
    ):
        if there is not None and encoder.mastering:
            lines.kept.append(what)
        elif there is not None:
            lines.dropped.append(f"{what} is not kept: {name} has no place for it here")
    lines.dropped += [f"{what} cannot be written here" for what in streams.embedded]
    aspect = info.sample_aspect_ratio
    if aspect != 1 and plan.container == "nut":
        shape = f"{aspect.numerator}:{aspect.denominator}"
        lines.dropped.append(f"pixels of {shape} are not kept: they are not written to {label_of(plan.container)}")
    if plan.container in PIPED:
        _piped_facts(plan, lines, info)
    return replace(
        plan,
        alpha=alpha,
        aspect=aspect
        if CONTAINER_FORMATS[plan.container].apart_aspect and plan.codec not in _ASPECT_IN_STREAM
        else Fraction(1),
        fields=streams.fields,
        mastering=streams.mastering if encoder.mastering else None,
        light=streams.light if encoder.mastering else None,
    )


def _piped_facts(plan: Plan, lines: _Lines, info: MediaInfo) -> None:
    name, tags = label_of(plan.container), (info.color_primaries, info.color_transfer, info.color_matrix)
    full_range = plan.container == "nut" and plan.format.full_range and not plan.format.is_rgb
    if any(tag not in (0, UNSPECIFIED) for tag in tags) or full_range:
        range_note = ", full range" if full_range else ""
        codes = f"H.273 primaries {tags[0]}, transfer {tags[1]}, matrix {tags[2]}{range_note}"
        lines.dropped.append(f"the colour tags are not kept: {name} has no place for them ({codes})")
    if plan.container == "y4m":
        lines.changed.append("time stamps become those of an even frame rate, as YUV4MPEG2 has it")


def _with_tracks(plan: Plan, lines: _Lines, streams: Streams, audio: str) -> Plan:
    """Sounds, subtitles, attachments; data and further pictures are never kept."""
    sounds: list[Carried] = []
    subtitles: list[Carried] = []
    attachments: list[Track] = []
    for track in streams.tracks:
        if track.kind == "sound":
            if audio == "copy":
                _carry(lines, plan.container, sounds, track, *carry_sound(track, plan.container))
        elif track.kind == "subtitle":
            _carry(lines, plan.container, subtitles, track, *_subtitle(track, plan.container))
        elif track.kind == "attachment" and CONTAINER_FORMATS[plan.container].attachments and track.name:
            attachments.append(track)
            lines.kept.append(track.label)
        else:
            lines.dropped.append(f"{track.label} is not kept")
    for kin in (sounds, subtitles):
        if kin and has_edits(plan.container) and not any(_is_default(one.track) for one in kin):
            lines.changed.append(
                f"{kin[0].track.label} is marked as default, as {label_of(plan.container)} asks of one"
            )
    return replace(plan, sounds=tuple(sounds), subtitles=tuple(subtitles), attachments=tuple(attachments))


def _is_default(track: Track) -> bool:
    return "default" in track.dispositions


def _carry(
    lines: _Lines, container: str, carried: list[Carried], track: Track, way: str | None, encoder: str | None
) -> None:
    if way is None:
        lines.dropped.append(f"{track.label} is not kept: {label_of(container)} holds no such track")
        return
    carried.append(Carried(track, encoder))
    if encoder is None:
        lines.kept.append(track.label)
    else:
        lines.changed.append(f"{track.label} becomes {way}")
    lost = _lost_of(track, container)
    if lost:
        lines.dropped.append(f"{track.label} goes without its {' and '.join(lost)}")


def _lost_of(track: Track, container: str) -> list[str]:
    """Facts of a carried track that its new container has no place for."""
    lost, holds = [], CONTAINER_FORMATS[container]
    if track.language and language_in(container, track.language) is None:
        lost.append("language")
    handler = track.handler if track.handler != track.title else None
    if handler and not holds.edits:
        lost.append("handler name")
    marks = [one for one in track.dispositions if one not in holds.dispositions]
    if marks:
        lost.append(f"mark ({', '.join(marks)})")
    if track.tags and not holds.matroska_tags:
        lost.append(f"tags ({', '.join(name for name, _ in track.tags)})")
    return lost


def _subtitle(track: Track, container: str) -> tuple[str | None, str | None]:
    """(what it becomes or "itself", the encoder or None); (None, None) when it cannot go along."""
    text = CONTAINER_FORMATS[container].text_subtitles
    if track.codec in CONTAINER_FORMATS[container].subtitles:
        return "itself", None
    if text is None or track.codec not in _TEXT:
        return None, None
    simplified = ", its styles simplified" if track.codec in ("ass", "mov_text") else ""
    return f"{text}{simplified}: {label_of(container)} does not hold {track.codec}", text


def _with_tags(plan: Plan, lines: _Lines, info: MediaInfo, streams: Streams) -> Plan:
    """What is written beside the tracks, and about them: chapters, tags, timecode."""
    chapters = _chapters(lines, plan.container, streams)
    metadata = _metadata(lines, plan.container, streams)
    if streams.picture is not None and (lost := _lost_of_picture(streams.picture, plan.container)):
        lines.dropped.append(f"the picture track goes without its {' and '.join(lost)}")
    timecode = _timecode(lines, plan.container, info, streams)
    reel = _reel(lines, plan.container, timecode, streams)
    if streams.location:
        lines.dropped.append(f"tags that tell a place are left out on purpose ({', '.join(streams.location)})")
    return replace(plan, chapters=chapters, metadata=metadata, picture=streams.picture, timecode=timecode, reel=reel)


def _chapters(lines: _Lines, container: str, streams: Streams) -> tuple[Chapter, ...]:
    chapters = streams.chapters
    if chapters and not CONTAINER_FORMATS[container].chapters:
        lines.dropped.append(f"{len(chapters)} chapters are not kept: they are not written to {label_of(container)}")
        chapters = ()
    elif chapters:
        lines.kept.append(f"{len(chapters)} chapters")
    if streams.chapters_after:
        lines.dropped.append(f"{streams.chapters_after} chapters that begin after the clip's end are not kept")
    return chapters


def _metadata(lines: _Lines, container: str, streams: Streams) -> tuple[tuple[str, str], ...]:
    names = ", ".join(key for key, _ in streams.metadata)
    if streams.metadata and not CONTAINER_FORMATS[container].tags:
        lines.dropped.append(f"tags are not kept: they are not written to {label_of(container)} ({names})")
        return ()
    if streams.metadata:
        lines.kept.append(f"tags: {names}")
    return streams.metadata


def _timecode(lines: _Lines, container: str, info: MediaInfo, streams: Streams) -> str | None:
    timecode = streams.timecode
    if timecode is None:
        return None
    why = _timecode_fault(timecode, info, container)
    if why is not None:
        lines.dropped.append(f"timecode {timecode} is not kept: {why}")
        return None
    lines.kept.append(f"timecode {timecode}")
    return timecode


def _reel(lines: _Lines, container: str, timecode: str | None, streams: Streams) -> str | None:
    """The reel's name, which goes with the timecode that is kept."""
    if streams.reel is None:
        return None
    if container != "mov" or timecode is None:
        lines.dropped.append(f"reel name {streams.reel} is not kept: a timecode in MOV alone has one")
        return None
    lines.kept.append(f"reel name {streams.reel}")
    return streams.reel


def _lost_of_picture(picture: Track, container: str) -> list[str]:
    if container == "y4m":
        return ["title"] * bool(picture.title) + ["language"] * bool(picture.language)
    return _lost_of(replace(picture, dispositions=()), container)


def _timecode_fault(timecode: str, info: MediaInfo, container: str) -> str | None:
    if not CONTAINER_FORMATS[container].timecode:
        return f"{label_of(container)} has no place for it"
    parsed = _TIMECODE.match(timecode)
    if container == "matroska":
        return None
    rate = round(info.frame_rate or 0)
    if parsed is None or rate < 1:
        return "it cannot be read"
    if parsed[1] != ":" and rate % 30:
        return "drop frame goes with 30 and 60 frames a second"
    return None
