"""What else a clip's file holds beside its pictures: sound, subtitles, chapters, tags, HDR metadata, fields, alpha."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, cast

import av
import av.container
import av.filter
import av.stream
import av.video.frame
import numpy as np

from pvg.video.decoding import has_alpha
from pvg.video.encoders import FieldOrder
from pvg.video.languages import stated_language
from pvg.video.mastering import ContentLight, MasteringDisplay
from pvg.video.opening import MediaLimits, open_clip, open_container
from pvg.video.reading import pictures
from pvg.video.side_data import side_data

Kind = Literal["picture", "sound", "subtitle", "data", "attachment"]

_KINDS: dict[str, Kind] = {
    "video": "picture",
    "audio": "sound",
    "subtitle": "subtitle",
    "attachment": "attachment",
}
_SAME_CODEC = {"subrip": "srt", "ssa": "ass", "dvd_subtitle": "dvdsub", "hdmv_pgs_subtitle": "pgssub"}
_EMBEDDED = (  # what rides in the coded pictures and goes with them
    (("DOVI_METADATA", "DOVI_RPU_BUFFER"), "Dolby Vision metadata"),
    (("DYNAMIC_HDR_PLUS",), "HDR10+ metadata"),
    (("DYNAMIC_HDR_VIVID",), "HDR Vivid metadata"),
    (("AMBIENT_VIEWING_ENVIRONMENT",), "the ambient viewing environment"),
    (("A53_CC",), "closed captions inside the pictures"),
    (("STEREO3D",), "the mark of a stereo pair"),
    (("SPHERICAL",), "the mark of a spherical picture"),
    (("ICC_PROFILE",), "the pictures' ICC profile"),
    (("AFD",), "the active format description"),
)
_TOP_FIRST, _BOTTOM_FIRST = (2, 4), (3, 5)  # AVFieldOrder: TT, TB; BB, BT, as decoders and libav's tools use them

# made anew by every muxer, or said of the coded stream that is not kept
_MADE_BY_MUXERS = frozenset(
    {"major_brand", "minor_version", "compatible_brands", "encoder", "vendor_id", "duration", "rotate", "bps"}
    | {"number_of_frames", "number_of_bytes", "source_id", "creation_time_of_track", "alpha_mode", "encoding_params"}
)
_LOCATION_WORDS = ("location", "xyz", "gps", "latitude", "longitude", "altitude", "geotag")
_CHANNEL_ORDER = tuple(channel.name for channel in av.AudioLayout("22.2").channels)
"""Names of channels in the order that layouts with a name have them in."""
_PLAIN_HANDLERS = ("handler", "core media", "iso media", "gpac", "mainconcept")


@dataclass(frozen=True)
class Track:
    """One stream beside the pictures.

    index: of the stream in the file. codec: libav's name of its decoder, "unknown" without one. language: as stored
    (ISO 639-2, or BCP 47 in Matroska), title: None when not stated. handler: QuickTime's name of what it is, None for
    one that only names the kind. dispositions: libav's names ("default", "forced", "comment", …). sample: libav's
    name of a sound's sample format. rate: of its samples in a second, layout, channels: libav's name of where they are
    heard and how many there are; 0 and "" when not stated. order: names of the channels, where that is not the order
    of their layout. tags: others that it carries. name: of an attachment's file.
    """

    index: int
    kind: Kind
    codec: str
    language: str | None = None
    title: str | None = None
    handler: str | None = None
    dispositions: tuple[str, ...] = ()
    sample: str | None = None
    rate: int = 0
    layout: str = ""
    channels: int = 0
    order: tuple[str, ...] = ()
    tags: tuple[tuple[str, str], ...] = ()
    name: str | None = None

    @property
    def label(self) -> str:
        """Its name in messages."""
        about = [self.codec]
        about += [self.language] if self.language else []
        about += [f'"{self.title or self.handler}"'] if self.title or self.handler else []
        about += [self.name] if self.name else []
        what = {"sound": "sound track", "subtitle": "subtitle track", "data": "data track", "picture": "picture track"}
        return f"{what.get(self.kind, self.kind)} {self.index} ({', '.join(about)})"


@dataclass(frozen=True)
class Chapter:
    """A stretch of the clip, in seconds of its own time, and its name, if it has one."""

    start_s: Fraction
    end_s: Fraction
    title: str | None


@dataclass(frozen=True)
class Streams:
    """All that a clip's file holds beside its pictures.

    tracks: every other stream but those that chapters and a timecode are stored in. chapters: none ends after the clip,
    and `chapters_after` that begin after it are left out. metadata: tags of the file, without those a muxer makes
    itself; location: names of the tags that tell a place. picture: the language, title and other tags of the pictures'
    own track. timecode: of the first frame, "hh:mm:ss:ff" or with ";" for drop frame. reel: the name of the tape or
    card that the timecode is of.
    fields: None for progressive pictures. alpha: the pictures come with it. embedded: what rides inside the
    coded pictures, in words.
    """

    tracks: tuple[Track, ...] = ()
    chapters: tuple[Chapter, ...] = ()
    chapters_after: int = 0
    metadata: tuple[tuple[str, str], ...] = ()
    location: tuple[str, ...] = ()
    picture: Track | None = None
    timecode: str | None = None
    reel: str | None = None
    fields: FieldOrder | None = None
    alpha: bool = False
    mastering: MasteringDisplay | None = None
    light: ContentLight | None = None
    embedded: tuple[str, ...] = ()


NO_STREAMS = Streams()


def read_streams(path: str | Path, limits: MediaLimits | None = None) -> Streams:
    """Take stock of a clip; one picture of it is decoded. Raises MediaError where it cannot be opened or decoded."""
    path, limits = Path(path), limits or MediaLimits()
    with open_clip(path, limits) as clip:
        chosen = clip.stream.index
        clip.stream.thread_type = "SLICE"  # one picture is wanted, not as many as there are cores
        order = clip.stream.codec_context.field_order
        first = next(pictures(clip), None)
        order = clip.stream.codec_context.field_order or order
        found = {} if first is None else side_data(first)
        fields = None if first is None else fields_of(first, order)
        alpha = first is not None and has_alpha(first)
        return streams_of(clip.container, chosen, found, fields, alpha, clip.set_aside)


def read_sounds(path: str | Path) -> Streams:
    """The sound tracks alone, without decoding. Raises MediaError where the file cannot be opened."""
    with open_container(Path(path), 2**30) as container:
        return Streams(tracks=tuple(_track(stream) for stream in container.streams.audio))


def streams_of(
    container: av.container.InputContainer,
    chosen: int,
    found: Mapping[str, bytes],
    fields: FieldOrder | None,
    alpha: bool,
    set_aside: frozenset[int] = frozenset(),
) -> Streams:
    """What an open file holds beside the pictures of stream `chosen`; the rest is known by one of these."""
    streams = list(container.streams)
    # such as the text of QuickTime's chapters, which are read as what they are
    tracks = [_track(stream) for stream in streams if stream.index not in set_aside]
    own, timecode, locations = _normal(container.metadata), None, []
    for tags in (own, *(_normal(stream.metadata) for stream in streams)):
        timecode = timecode or tags.get("timecode")
        locations += [name for name in tags if _is_location(name)]
    reels = [_normal(stream.metadata).get("reel_name") for stream in streams if stream.type == "data"]
    chapters = tuple(_chapters(cast("Iterable[Mapping[str, Any]]", container.chapters())))
    within = tuple(_until(_end_s(container), chapters))
    timecoded = {stream.index for stream in streams if stream.type == "data" and "timecode" in _normal(stream.metadata)}
    return Streams(
        tracks=tuple(track for track in tracks if track.index != chosen and track.index not in timecoded),
        chapters=within,
        chapters_after=len(chapters) - len(within),
        metadata=tuple((name, value) for name, value in own.items() if _is_kept(name)),
        location=tuple(dict.fromkeys(locations)),
        picture=next(track for track in tracks if track.index == chosen),
        timecode=timecode,
        reel=next((reel for reel in reels if reel), None),
        fields=fields,
        alpha=alpha,
        mastering=MasteringDisplay.of_side_data(found.get("MASTERING_DISPLAY_METADATA", b"")),
        light=ContentLight.of_side_data(found.get("CONTENT_LIGHT_LEVEL", b"")),
        embedded=tuple(words for names, words in _EMBEDDED if any(name in found for name in names)),
    )


def _normal(tags: Mapping[str, str]) -> dict[str, str]:
    """Tags by their names as MP4 has them; Matroska's are in capitals."""
    return {name.lower() if name.isupper() or name.upper() == name else name: value for name, value in tags.items()}


def _is_kept(name: str) -> bool:
    made_anew = name in _MADE_BY_MUXERS or name == "timecode" or name.startswith("_statistics")
    return not made_anew and not _is_location(name)


def _is_location(name: str) -> bool:
    return any(word in name.lower() for word in _LOCATION_WORDS)


def _track(stream: av.stream.Stream) -> Track:
    tags = _normal(stream.metadata)
    context: Any = stream.codec_context
    name = context.name.removeprefix("lib") if context is not None else str(getattr(stream, "name", None) or "unknown")
    kind = _KINDS.get(stream.type, "data")
    sounds = kind == "sound" and context is not None
    handler = tags.get("handler_name", "").strip("\0 \t")
    language = tags.get("language")
    layout, channels, order = _channels(context) if sounds else ("", 0, ())
    listed = {"language", "title", "name", "handler_name", "timecode", "creation_time", "filename", "mimetype"}
    others = {k: v for k, v in tags.items() if k not in listed | _MADE_BY_MUXERS and not _is_location(k)}
    return Track(
        index=stream.index,
        kind=kind,
        codec=_SAME_CODEC.get(name, name),
        language=None if language in (None, "und") else stated_language(language),
        title=tags.get("title") or tags.get("name"),
        handler=handler if handler and not any(word in handler.lower() for word in _PLAIN_HANDLERS) else None,
        dispositions=tuple(one.name or "" for one in av.stream.Disposition if stream.disposition & one),
        sample=context.format.name if sounds and context.format else None,
        rate=context.sample_rate or 0 if sounds else 0,
        layout=layout,
        channels=channels,
        order=order,
        tags=tuple((k, v) for k, v in others.items() if not k.startswith("_statistics")),
        name=tags.get("filename"),
    )


def _channels(context: Any) -> tuple[str, int, tuple[str, ...]]:
    """The layout, number and, where it is not that of the layout, order of a track's channels; see `Track`.

    PyAV's object shares a list of channels with what it was read from, and frees it: it is read once and then replaced.
    """
    stated = context.layout
    if not stated.nb_channels:
        return "", 0, ()
    context.layout = f"{stated.nb_channels} channels"
    if " channels (" not in stated.name:
        return stated.name, stated.nb_channels, ()
    order = tuple(channel.name for channel in stated.channels)
    if len({*order} & {*_CHANNEL_ORDER}) < len(order):
        return f"{len(order)} channels", len(order), order
    usual = tuple(sorted(order, key=_CHANNEL_ORDER.index))
    return av.AudioLayout("+".join(usual)).name, len(order), () if order == usual else order


def _chapters(stored: Iterable[Mapping[str, Any]]) -> Iterator[Chapter]:
    for chapter in stored:
        step = chapter["time_base"] or Fraction(1, 1000)
        title = _normal(chapter["metadata"]).get("title")
        yield Chapter(chapter["start"] * step, chapter["end"] * step, title or None)


def _end_s(container: av.container.InputContainer) -> Fraction | None:
    """When the last of a file's tracks ends at the latest, if it says so: some count from zero, others from its begin.

    libav's NUT tells when the last packets begin.
    """
    if not container.duration or container.format.name == "nut":
        return None
    return Fraction(max(0, container.start_time or 0) + container.duration, 1_000_000)


def _until(end_s: Fraction | None, chapters: Iterable[Chapter]) -> Iterator[Chapter]:
    """Chapters up to then: MP4 has them in a track, and a clip lasts as long as its longest one."""
    for chapter in chapters:
        if end_s is None or chapter.start_s < end_s:
            yield chapter if end_s is None else replace(chapter, end_s=min(chapter.end_s, end_s))


def fields_of(picture: av.video.frame.VideoFrame, order: int = 0) -> FieldOrder | None:
    """Which field is the earlier, None for a progressive picture; the picture is spent by it.

    The decoder's word for its own pictures counts, else the container's: order, an AVFieldOrder.
    """
    if picture.interlaced_frame:
        return _first_field(picture)
    if order in _TOP_FIRST:
        return "tff"
    return "bff" if order in _BOTTOM_FIRST else None


def _first_field(picture: av.video.frame.VideoFrame) -> FieldOrder:
    """The field that libav takes apart first; PyAV does not show the decoder's mark of it."""
    marked = _samples(picture)
    marked[0], marked[1] = 0, 255  # of a picture that nobody needs afterwards
    graph = av.filter.Graph()
    source = graph.add_buffer(
        width=picture.width,
        height=picture.height,
        format=picture.format,
        time_base=picture.time_base or Fraction(1, 25),
    )
    apart, sink = graph.add("separatefields"), graph.add("buffersink")
    source.link_to(apart)
    apart.link_to(sink)
    graph.configure()
    source.push(picture)
    first: Any = sink.pull()
    return "tff" if not _samples(first)[0].any() else "bff"


def _samples(picture: av.video.frame.VideoFrame) -> Any:
    """The bytes of the first plane, a row each; what is written changes the picture."""
    plane = picture.planes[0]
    return np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)[:, : picture.width]
