"""Opening a clip with nothing but its own bytes, and the limits a clip must keep."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.container
import av.error
import av.stream
import av.video.stream

from pvg.errors import MediaError
from pvg.video.sniffing import IMAGE_KINDS, check_structure, sniff

_DEMUXERS = {"mp4": "mov", "matroska": "matroska", "avi": "avi"}
# from PyAV 19 on tags that are not UTF-8 are always read so, and the argument is gone
_LENIENT: dict[str, Any] = {"metadata_errors": "replace"} if int(av.__version__.partition(".")[0]) < 19 else {}


@dataclass(frozen=True)
class MediaLimits:
    """What is accepted; beyond any of these a MediaError names the number.

    max_pixels: of one frame. max_frames, max_duration_s: of the clip. max_frame_rate: frames a second on average.
    max_streams: video, sound, subtitles and all else in the container.
    """

    max_pixels: int = 33_554_432
    max_frames: int = 200_000
    max_duration_s: float = 3600.0
    max_frame_rate: float = 240.0
    max_streams: int = 16


@dataclass(frozen=True)
class OpenClip:
    """An open container and its picture stream; `name` is for messages."""

    name: str
    container: av.container.InputContainer
    stream: av.video.stream.VideoStream

    @property
    def time_base(self) -> Fraction:
        """Seconds a tick."""
        return self.stream.time_base or Fraction(1, 1_000_000)


@contextmanager
def open_container(path: Path, max_pixels: int) -> Iterator[av.container.InputContainer]:
    """Open a clip with the demuxer its bytes call for; only this file can be read. Raises MediaError."""
    kind = sniff(path)
    if kind in IMAGE_KINDS:
        raise MediaError(f"{path.name} is a still picture, not a clip")
    check_structure(path, kind, max_pixels)
    options = {"protocol_whitelist": "file", "max_pixels": _decoder_limit(max_pixels)}
    if kind == "mp4":
        options |= {"enable_drefs": "0", "use_absolute_path": "0"}
    try:
        container = av.open(f"file:{path.absolute()}", "r", format=_DEMUXERS[kind], options=options, **_LENIENT)
    except (av.error.FFmpegError, ValueError, UnicodeDecodeError) as error:
        raise MediaError(f"{path.name} is damaged: its header cannot be read ({reason(error)})") from error
    with container:
        yield container


@contextmanager
def open_clip(path: Path, limits: MediaLimits) -> Iterator[OpenClip]:
    """Open a clip and choose its picture stream (cover art is none). Raises MediaError."""
    with open_container(path, limits.max_pixels) as container:
        if len(container.streams) > limits.max_streams:
            raise MediaError(
                f"{path.name} has {len(container.streams)} streams; at most {limits.max_streams} are accepted"
            )
        cover = av.stream.Disposition.attached_pic
        streams = [stream for stream in container.streams.video if not stream.disposition & cover]
        if not streams:
            what = "only sound" if container.streams.audio else "no pictures"
            raise MediaError(f"{path.name} has {what}; a clip with a video track is needed")
        stream = streams[0]
        if stream.codec_context is None:
            raise MediaError(f"{path.name} uses a video codec that is not known here; convert it to H.264")
        for other in container.streams:
            if other.index != stream.index:
                other.discard = av.stream.Discard.all
        stream.codec_context.options = {"max_pixels": _decoder_limit(limits.max_pixels)}
        stream.thread_type = "AUTO"
        yield OpenClip(path.name, container, stream)


def _decoder_limit(max_pixels: int) -> str:
    """A guard for the decoders, which count padded rows and columns too; our own check of the size is exact."""
    return str(min(2 * max_pixels + 65536, 2**31 - 1))


def reason(error: BaseException) -> str:
    """The short text of a libav error, without paths."""
    return str(getattr(error, "strerror", None) or error).splitlines()[0].lower()
