"""The plan of a new clip: what `keeping` decides on, writers and muxers carry out, and people are told."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from pvg.video.encoders import FieldOrder
from pvg.video.formats import PixelFormat
from pvg.video.mastering import ContentLight, MasteringDisplay
from pvg.video.streams import Chapter, Track

_PLAIN_TAGS = {"title", "artist", "album", "date", "comment", "genre", "copyright", "creation_time"}
_PLAIN_IN_MP4 = {"album_artist", "composer", "description"}


@dataclass(frozen=True)
class Carried:
    """A track that goes along: copied when `encoder` is None, else through that libav encoder."""

    track: Track
    encoder: str | None = None


@dataclass(frozen=True)
class Plan:
    """What a new clip is made of, and in words what is kept, changed and dropped of the source's.

    container: of `CONTAINER_FORMATS`. format: of the encoded pictures, width, height: their size. source: the file that
    sounds, subtitles and attachments come from; None when there are none. aspect: of a pixel, where neither encoder nor
    muxer says it and the finished file is to; else 1.
    """

    container: str
    codec: str
    format: PixelFormat
    width: int
    height: int
    alpha: bool = False
    aspect: Fraction = Fraction(1)
    fields: FieldOrder | None = None
    mastering: MasteringDisplay | None = None
    light: ContentLight | None = None
    source: Path | None = None
    sounds: tuple[Carried, ...] = ()
    subtitles: tuple[Carried, ...] = ()
    attachments: tuple[Track, ...] = ()
    chapters: tuple[Chapter, ...] = ()
    metadata: tuple[tuple[str, str], ...] = ()
    picture: Track | None = None
    timecode: str | None = None
    reel: str | None = None
    kept: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is not as in the source, one line each."""
        return self.changed + self.dropped


def needs_general_tags(plan: Plan) -> bool:
    """Whether MP4 and MOV keep all tags only where any name goes, which fewer players look into."""
    plain = _PLAIN_TAGS | _PLAIN_IN_MP4 if plan.container == "mp4" else _PLAIN_TAGS
    return any(name not in plain for name, _ in plan.metadata)
