"""Containers that clips are written as: what each holds, in one table.

Who adds a container adds a row here and what is peculiar to its muxer in `muxing` and `keeping`. Its name is said again
where this module takes too long to load or may not be imported: `pvg._options` and `pvg._outputs` (the command),
`service/catalog/requests.py` (HTTP) and `service/web/js/output.js` (the page).
"""

from __future__ import annotations

from dataclasses import dataclass

PCM = frozenset(
    {f"pcm_s{bits}{end}" for bits in (16, 24, 32) for end in ("le", "be")} | {"pcm_f32le", "pcm_f64le", "pcm_u8"}
)
"""Sound codecs without compression that containers of PCM take, by libav's names."""

_BITMAP_SUBTITLES = ("dvdsub", "pgssub", "dvbsub")
_MARKS = frozenset({"default", "dub", "comment", "forced", "hearing_impaired", "visual_impaired"})


@dataclass(frozen=True)
class ContainerFormat:
    """What one container holds, as libav's muxer writes it.

    label: its name in messages. suffixes: of files, the first is what is written; none of what goes to pipes alone.
    aliases: other names that callers may give it. codecs: of pictures, see `encoders.ENCODERS`. sounds: codecs (names
    of libav decoders) that the muxer takes and common players then play. takes_pcm: whether any PCM is written as PCM.
    subtitles: codecs that are copied; text_subtitles: what other text becomes, None where there is no place for any.
    dispositions: what tracks are marked as, by libav's names, that is written. edits: tells what is before the
    beginning; in others all is moved until nothing is before zero. matroska_tags: a track has tags of any name.
    attachments: holds files. tags, chapters, timecode: of the clip. apart_aspect: its own place for a pixel's aspect is
    one that PyAV does not fill.
    """

    label: str
    suffixes: tuple[str, ...]
    codecs: tuple[str, ...]
    sounds: frozenset[str]
    subtitles: tuple[str, ...]
    text_subtitles: str | None
    dispositions: frozenset[str]
    aliases: tuple[str, ...] = ()
    takes_pcm: bool = False
    edits: bool = False
    matroska_tags: bool = False
    attachments: bool = False
    tags: bool = True
    chapters: bool = True
    timecode: bool = False
    apart_aspect: bool = False

    @property
    def is_piped(self) -> bool:
        """Whether it is written to pipes."""
        return not self.suffixes


CONTAINER_FORMATS = {
    "mp4": ContainerFormat(
        label="MP4",
        suffixes=(".mp4", ".m4v"),
        codecs=("h264", "hevc", "vp9", "av1"),
        sounds=frozenset({"aac", "mp3", "mp3float", "mp2", "ac3", "eac3", "alac", "flac", "opus"}),
        subtitles=("mov_text",),
        text_subtitles="mov_text",
        dispositions=_MARKS | {"captions", "descriptions"},
        edits=True,
        timecode=True,
    ),
    "mov": ContainerFormat(
        label="MOV",
        suffixes=(".mov",),
        codecs=("h264", "hevc", "prores", "prores4444", "dnxhr"),  # libav's muxer takes no FFV1
        sounds=PCM
        | {"aac", "mp3", "mp3float", "ac3", "eac3", "alac", "pcm_f32be", "pcm_f64be", "pcm_alaw", "pcm_mulaw"},
        takes_pcm=True,
        subtitles=("mov_text",),
        text_subtitles="mov_text",
        dispositions=frozenset({"default"}),
        edits=True,
        timecode=True,
    ),
    "matroska": ContainerFormat(
        label="Matroska",
        suffixes=(".mkv",),
        aliases=("mkv",),
        codecs=("h264", "hevc", "vp9", "av1", "ffv1", "prores", "prores4444"),  # libav's muxer takes no DNxHR
        sounds=PCM
        | {"aac", "mp3", "mp3float", "mp2", "ac3", "eac3", "alac", "flac", "opus", "vorbis", "dca", "truehd"}
        | {"wavpack", "tta"},
        takes_pcm=True,
        subtitles=("srt", "ass", "webvtt", *_BITMAP_SUBTITLES),
        text_subtitles="srt",
        dispositions=_MARKS | {"original"},
        matroska_tags=True,
        attachments=True,
        timecode=True,
        apart_aspect=True,
    ),
    "webm": ContainerFormat(
        label="WebM",
        suffixes=(".webm",),
        codecs=("vp9", "av1"),
        sounds=frozenset({"opus", "vorbis"}),
        subtitles=("webvtt",),
        text_subtitles="webvtt",
        dispositions=frozenset({"default", "forced"}),
        matroska_tags=True,
        apart_aspect=True,
    ),
    "nut": ContainerFormat(
        label="NUT",
        suffixes=(),
        codecs=("raw", "ffv1"),
        sounds=PCM | {"aac", "mp3", "mp3float", "mp2", "ac3", "flac", "opus", "vorbis"},
        takes_pcm=True,
        subtitles=(),
        text_subtitles=None,
        dispositions=frozenset({"default"}),
    ),
    "y4m": ContainerFormat(
        label="YUV4MPEG2",
        suffixes=(),
        codecs=("raw",),
        sounds=frozenset(),
        subtitles=(),
        text_subtitles=None,
        dispositions=frozenset(),
        tags=False,
        chapters=False,
    ),
}
"""By libav's name of the muxer, but for y4m, which is written here."""

CONTAINERS = {
    **{suffix: name for name, one in CONTAINER_FORMATS.items() for suffix in one.suffixes},
    **{alias: name for name, one in CONTAINER_FORMATS.items() for alias in (*one.aliases, name)},
}
"""Suffixes and names that callers give, and what they stand for in `CONTAINER_FORMATS`."""
CLIP_SUFFIXES = tuple(key for key in CONTAINERS if key.startswith("."))
PIPED = tuple(name for name, one in CONTAINER_FORMATS.items() if one.is_piped)
"""The containers that are written to pipes."""


def label_of(container: str) -> str:
    """A container's name in messages."""
    return CONTAINER_FORMATS[container].label


def short_name(container: str) -> str:
    """What callers call a container, and its files end in: mp4, mov, mkv, webm, nut or y4m."""
    suffixes = CONTAINER_FORMATS[container].suffixes
    return suffixes[0][1:] if suffixes else container


def has_edits(container: str) -> bool:
    """Whether the container tells what is before the beginning, by an edit list."""
    return CONTAINER_FORMATS[container].edits
