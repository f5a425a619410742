"""Opening a clip with nothing but its own bytes, and the limits a clip must keep."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

import av
import av.codec
import av.codec.context
import av.container
import av.error
import av.packet
import av.stream
import av.video.codeccontext
import av.video.frame
import av.video.stream

from pvg._checks import real_number
from pvg._processors import decoding_threads
from pvg.errors import MediaError, TooLargeError
from pvg.video.indexes import check_index
from pvg.video.sniffing import IMAGE_KINDS, check_structure, sniff

Packet: TypeAlias = "av.packet.Packet[av.video.stream.VideoStream]"

_ALPHA_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}
_DEMUXERS = {"mp4": "mov", "matroska": "matroska", "avi": "avi"}
# without it, libav leaves columns that pictures are cropped by on the left where they are, for its memory's alignment
_EXACT_CROP = av.codec.context.Flags.unaligned
# from PyAV 19 on tags that are not UTF-8 are always read so, and the argument is gone
_LENIENT: dict[str, Any] = {"metadata_errors": "replace"} if int(av.__version__.partition(".")[0]) < 19 else {}


@dataclass(frozen=True)
class MediaLimits:
    """What is accepted; beyond any of these a TooLongError (frames, duration) or TooLargeError names the number.

    max_pixels: of one frame. max_frames, max_duration_s: of the clip. max_frame_rate: frames a second on average, of
    which 1 % more passes.
    max_streams: video, sound, subtitles and all else in the container.
    Each is a number from 0 on, infinity for no limit; ValueError for anything else.
    """

    max_pixels: int = 33_554_432
    max_frames: int = 200_000
    max_duration_s: float = 3600.0
    max_frame_rate: float = 240.0
    max_streams: int = 32

    def __post_init__(self) -> None:
        """Look at what was given: what is no number would be no limit, or be compared with one."""
        for limit in fields(self):
            real_number(limit.name, getattr(self, limit.name), 0.0, math.inf)


@dataclass(frozen=True)
class StatedColors:
    """What a container says of its pictures' colours: code points of ISO/IEC 23091-2, and the range.

    2, of the range 0: not stated. A decoder writes over it what the pictures say, even where they say nothing.
    """

    primaries: int = 2
    transfer: int = 2
    matrix: int = 2
    color_range: int = 0


@dataclass(frozen=True)
class OpenClip:
    """An open container and its picture stream; `name` is for messages.

    choices: how many picture streams there were. decoder: one of its own where the stream's drops alpha, or None.
    set_aside: indices of streams that the demuxer itself sets aside, such as the text of QuickTime's chapters.
    colors: as they stood before anything was decoded.
    """

    name: str
    container: av.container.InputContainer
    stream: av.video.stream.VideoStream
    choices: int = 1
    decoder: av.video.codeccontext.VideoCodecContext | None = None
    set_aside: frozenset[int] = frozenset()
    colors: StatedColors = StatedColors()

    @property
    def context(self) -> av.video.codeccontext.VideoCodecContext:
        """What decodes."""
        return self.stream.codec_context if self.decoder is None else self.decoder

    @property
    def stamps_are_of_coding(self) -> bool:
        """Whether time stamps are those of coding, not of display: AVI has no others."""
        return self.container.format.name == "avi" and bool(self.stream.codec_context.has_b_frames)

    def packets(self, *, strict: bool = False) -> Iterator[Packet]:
        """The packets in file order, up to where the clip is cut off, and an empty one.

        Raises MediaError where data is missing in the middle; strict: also where the end is missing.
        """
        count, cut = 0, False
        for packet in self.container.demux(self.stream):
            if packet.size and (cut or (packet.is_corrupt and strict)):
                raise MediaError(
                    f"{self.name} is damaged or cut short after packet {count} of its pictures; upload it whole"
                )
            if packet.is_corrupt and packet.size:  # only a part of it is there, as at the end of a file
                cut = True
                continue
            yield packet
            count += 1

    def decode(self, packet: Packet) -> list[av.video.frame.VideoFrame]:
        """The shown pictures that a packet of the stream completes; an empty packet gives those still held."""
        if self.decoder is None:
            return [one for one in packet.decode() if not (self.is_mp4 and _is_before_zero(one))]
        return self.decoder.decode(packet if packet.size else None)

    def shows(self, packet: Packet) -> bool:
        """Whether the picture of a packet is shown."""
        return bool(packet.size) and not is_left_out(packet, self.container)

    def seek(self, pts: int) -> None:
        """Go to the key picture at or before a time stamp of the stream."""
        self.container.seek(pts, stream=self.stream, backward=True)
        if self.decoder is not None:
            self.decoder.flush_buffers()

    @property
    def is_mp4(self) -> bool:
        """Whether it is an MP4 or MOV, whose index is whole."""
        return self.container.format.name == _DEMUXERS["mp4"]

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
    check_index(path, kind)
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
    """Open a clip and its picture stream: the first that is marked default, or else the first; cover art is none.

    Raises MediaError.
    """
    with open_container(path, limits.max_pixels) as container:
        if len(container.streams) > limits.max_streams:
            message = f"{path.name} has {len(container.streams)} streams; at most {limits.max_streams} are accepted"
            raise TooLargeError(message, limits.max_streams, "streams")
        streams = _picture_streams(container)
        if not streams:
            what = "only sound" if container.streams.audio else "no pictures"
            raise MediaError(f"{path.name} has {what}; a clip with a video track is needed")
        stream = next((one for one in streams if one.disposition & av.stream.Disposition.default), streams[0])
        if stream.codec_context is None:
            raise MediaError(f"{path.name} uses a video codec that is not known here; convert it to H.264")
        aside = frozenset(one.index for one in container.streams if one.discard == av.stream.Discard.all)
        for other in container.streams:
            if other.index != stream.index:
                other.discard = av.stream.Discard.all
        stream.codec_context.options = {"max_pixels": _decoder_limit(limits.max_pixels)}
        stream.thread_type = "AUTO"
        context = stream.codec_context
        context.thread_count = decoding_threads()
        context.flags |= _EXACT_CROP
        colors = StatedColors(context.color_primaries, context.color_trc, context.colorspace, context.color_range)
        decoder = _alpha_decoder(stream, limits.max_pixels)
        yield OpenClip(path.name, container, stream, len(streams), decoder, aside, colors)


def is_left_out(packet: av.packet.Packet[Any], container: av.container.InputContainer) -> bool:
    """Whether the edit list of an MP4 leaves a packet out; its decoder may need it all the same.

    libav marks those of an index. What an edit list leaves out of fragments it puts before zero, and no more.
    """
    return packet.is_discard or (container.format.name == _DEMUXERS["mp4"] and _is_before_zero(packet))


def _is_before_zero(item: Any) -> bool:
    """Whether half of a packet or picture, or more, comes before zero: stamps may be off by their rounding."""
    return item.pts is not None and item.pts < 0 and 2 * item.pts + (item.duration or 0) <= 0


def _picture_streams(container: av.container.InputContainer) -> list[av.video.stream.VideoStream]:
    still = av.stream.Disposition.attached_pic | av.stream.Disposition.still_image
    return [stream for stream in container.streams.video if not stream.disposition & still]


def _alpha_decoder(
    stream: av.video.stream.VideoStream, max_pixels: int
) -> av.video.codeccontext.VideoCodecContext | None:
    """libvpx for VP8 and VP9 whose alpha lies beside the pictures (WebM, AlphaMode 1): libav's own decoders drop it."""
    name = _ALPHA_DECODERS.get(stream.codec_context.name)
    if name is None or stream.metadata.get("alpha_mode") != "1":
        return None
    try:
        context = av.codec.CodecContext.create(name, "r")
    except ValueError:  # a PyAV without libvpx: alpha is dropped
        return None
    assert isinstance(context, av.video.codeccontext.VideoCodecContext)  # noqa: S101 - narrows the binding's union
    context.options = {"max_pixels": _decoder_limit(max_pixels)}
    context.thread_type, context.thread_count = "AUTO", decoding_threads()
    return context


def _decoder_limit(max_pixels: int) -> str:
    """A guard for the decoders, which count padded rows and columns too; our own check of the size is exact."""
    return str(min(2 * max_pixels + 65536, 2**31 - 1))


def reason(error: BaseException) -> str:
    """The short text of a libav error, without paths."""
    return str(getattr(error, "strerror", None) or error).splitlines()[0].lower()
