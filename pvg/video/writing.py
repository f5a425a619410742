"""Frames into a clip: the source's depth, colours and time stamps, and its sound."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Literal, TypeAlias

import av
import av.codec
import av.container
import av.error
import av.packet
import av.video.frame
import av.video.stream
import numpy as np

from pvg.errors import MediaError
from pvg.video.audio import AudioTrack
from pvg.video.formats import RANGE_FULL, RANGE_LIMITED, Frame, Patch, PixelFormat
from pvg.video.info import MediaInfo
from pvg.video.opening import reason

_Packet: TypeAlias = "av.packet.Packet[av.video.stream.VideoStream]"

Codec = Literal["auto", "h264", "hevc", "vp9", "av1"]

_CONTAINERS = {
    **{".mp4": "mp4", ".m4v": "mp4", ".mov": "mov", ".mkv": "matroska", ".webm": "webm"},
    **{"mp4": "mp4", "mov": "mov", "mkv": "matroska", "matroska": "matroska", "webm": "webm"},
}
CLIP_SUFFIXES = tuple(key for key in _CONTAINERS if key.startswith("."))
_ENCODERS = {"h264": "libx264", "hevc": "libx265", "vp9": "libvpx-vp9", "av1": "libsvtav1"}
_BY_PREFERENCE = {False: ("h264", "hevc", "vp9", "av1"), True: ("hevc", "av1", "vp9", "h264")}  # 8 bits; above
_HELD = {"webm": ("vp9", "av1"), "mov": ("h264", "hevc")}  # the others hold all
_CRF = {"h264": 18, "hevc": 20, "vp9": 28, "av1": 26}
_PRESET = {"h264": "veryfast", "hevc": "veryfast", "vp9": "6", "av1": "8"}
_NAMES = ("veryslow", "slower", "slow", "medium", "fast", "faster", "veryfast", "superfast", "ultrafast")
_NAMED_EFFORT = {  # x264's names on the scales of the two that count
    "vp9": {name: str(k) for k, name in enumerate(_NAMES)},
    "av1": {name: str(k + 2) for k, name in enumerate(_NAMES)},
}


def choose_codec(codec: str, container: str, depth: int) -> str:
    """The codec "auto" stands for, or the codec itself.

    auto: h264 for 8 bits and hevc above (WebM: vp9, av1 above), or what comes next where PyAV was built without that
    encoder, as x264 and x265 often are left out for their licence. Raises ValueError for a codec that is unknown,
    unfit for the container, or has no encoder here.
    """
    if codec == "auto":
        wanted = _BY_PREFERENCE[depth > 8]
        fit = [name for name in wanted if name in _HELD.get(container, wanted)]
        there = next((name for name in fit if _has_encoder(name)), None)
        if there is None:
            raise ValueError(f"this PyAV has no encoder for {container}: none of {_encoders_of(fit)}")
        return there
    if codec not in _ENCODERS:
        raise ValueError(f"codec {codec!r} is not one of auto, {', '.join(_ENCODERS)}")
    if container == "webm" and codec not in _HELD["webm"]:
        raise ValueError(f"WebM holds vp9 or av1, not {codec}; write .mp4, .mov or .mkv")
    if container == "mov" and codec not in _HELD["mov"]:
        raise ValueError(f"MOV holds h264 or hevc, not {codec}; write .mp4, .mkv or .webm")
    if not _has_encoder(codec):
        raise ValueError(f"this PyAV has no {_ENCODERS[codec]} for {codec}; leave the codec to auto")
    return codec


def _has_encoder(codec: str) -> bool:
    try:
        av.codec.Codec(_ENCODERS[codec], "w")
    except ValueError:  # PyAV's UnknownCodecError
        return False
    return True


def _encoders_of(codecs: Sequence[str]) -> str:
    return ", ".join(_ENCODERS[codec] for codec in codecs)


def encoder_format(source: PixelFormat, codec: str) -> PixelFormat:
    """The format nearest to `source` that the encoder of `codec` takes: the same depth before the same chroma."""
    formats = {item.name for item in av.codec.Codec(_ENCODERS[codec], "w").video_formats or ()}
    weights, full = source.luma_weights, source.full_range
    if weights is None:  # R, G, B planes become BT.709, as for any picture without a matrix
        weights, full = (0.2126, 0.0722), False
    depths = sorted((8, 10, 12), key=lambda depth: (depth != source.depth, -depth if depth < source.depth else depth))
    chromas = sorted(
        (((1, 1), "420"), ((1, 0), "422"), ((0, 0), "444")),
        key=lambda item: (item[0] != source.chroma_log2, sum(item[0]) > sum(source.chroma_log2), -sum(item[0])),
    )
    for depth in depths:
        for chroma, digits in chromas:
            name = f"yuv{digits}p" + ("" if depth == 8 else f"{depth}le")
            if name in formats:
                return PixelFormat(name, depth, chroma, weights, full)
    raise ValueError(f"the {codec} encoder takes no planar Y'CbCr")


def encoder_options(codec: str, crf: int | None, preset: str | None) -> dict[str, str]:
    """Options of the libav encoder; crf 0 is lossless for h264 (8 bit), hevc and vp9."""
    quality = _CRF[codec] if crf is None else crf
    effort = _PRESET[codec] if preset is None else _NAMED_EFFORT.get(codec, {}).get(preset, preset)
    if codec == "h264":
        return {"crf": str(quality), "preset": effort}
    if codec == "hevc":
        lossless = ":lossless=1" if quality == 0 else ""
        return {"crf": str(quality), "preset": effort, "x265-params": f"log-level=none{lossless}"}
    if codec == "av1":
        os.environ.setdefault("SVT_LOG", "1")  # the library's only switch: errors, not a page of settings
        return {"crf": str(quality), "preset": effort}
    options = {"crf": str(quality), "b": "0", "deadline": "realtime", "cpu-used": effort, "row-mt": "1"}
    return options | ({"lossless": "1"} if quality == 0 else {})


@dataclass(frozen=True)
class _Tags:
    """Colour code points of ISO/IEC 23091-2 as they are written."""

    matrix: int
    color_range: int
    primaries: int
    transfer: int


def _tags(info: MediaInfo, source: PixelFormat, target: PixelFormat) -> _Tags:
    if source.is_rgb:
        return _Tags(1, RANGE_LIMITED, info.color_primaries, info.color_transfer)
    # An unstated limited range stays unstated, so that players make the same guess as before
    color_range = RANGE_FULL if target.full_range else info.color_range
    return _Tags(info.color_matrix, color_range, info.color_primaries, info.color_transfer)


class VideoWriter:
    """Writes frames as a clip; a context manager.

    path: .mp4, .mov, .mkv or .webm, or any name with `container` given. info: the source clip's; its time base,
    frame rate, colour tags and pixel aspect are kept. format: that of the frames to come.
    codec: see `choose_codec`. crf, preset: the encoder's own scales
    (for vp9 the preset is cpu-used, 0–8), or for all of them x264's names, "ultrafast" to "veryslow". threads: of the
    encoder, as many as suit the machine when 0; the same number gives the same bytes. audio_from: the clip whose sound
    is copied, or transcoded to AAC (Opus in WebM) where the container cannot hold it; None, or a clip without sound,
    gives a silent clip.

    Time stamps are exact in MP4 and MOV. Matroska and WebM count milliseconds and have no negative ones: sound
    that leads in moves both tracks by the same amount. Subsampled H.264 and HEVC need even sizes: a last odd
    column or row is dropped; VP9 and AV1 keep it. When the block is left by an exception the partial file is
    removed. Raises ValueError for options that do not fit, MediaError when encoding fails.
    """

    def __init__(
        self,
        path: str | Path,
        info: MediaInfo,
        format: PixelFormat,  # noqa: A002 - the name callers know from Frame
        *,
        codec: str = "auto",
        crf: int | None = None,
        preset: str | None = None,
        audio_from: str | Path | None = None,
        container: str | None = None,
        threads: int = 0,
    ) -> None:
        self.path = Path(path)
        key = container or self.path.suffix.lower()
        if key not in _CONTAINERS:
            raise ValueError(f"{self.path.name}: a clip is written as .mp4, .mov, .mkv or .webm")
        if info.time_base is None:
            raise ValueError("a still picture has no time base; write it with write_image")
        self._container_name = _CONTAINERS[key]
        self.codec = choose_codec(codec, self._container_name, format.depth)
        self._options = encoder_options(self.codec, crf, preset)
        self._source_format, self._info, self._threads = format, info, threads
        self._time_base = info.time_base
        self._audio_from = Path(audio_from) if audio_from is not None and info.has_audio else None
        self.format = encoder_format(format, self.codec)
        self._tags = _tags(info, format, self.format)
        x, y = (0, 0) if self.codec in ("vp9", "av1") else self.format.chroma_log2
        self.width, self.height = info.width >> x << x, info.height >> y << y
        if min(self.width, self.height) < 1:
            raise ValueError(f"{info.width}x{info.height} is too small for {self.codec} {self.format.name}")
        self._frames = 0
        self._last_pts: int | None = None
        self._first_pts = self._end_pts = 0
        self._held: _Packet | None = None
        self._first_dts: int | None = None

    def __enter__(self) -> VideoWriter:
        options: dict[str, str] = {}
        if self._container_name in ("mp4", "mov"):
            # Edit lists count in the movie's time scale: the clip's own keeps a late first frame exact
            scale = str(max(1000, self._time_base.denominator))
            options = {"movflags": "+faststart", "movie_timescale": scale}
        self._output = av.open(f"file:{self.path.absolute()}", "w", format=self._container_name, options=options)
        self._audio: AudioTrack | None = None
        try:
            self._stream = self._add_stream()
            if self._audio_from is not None:
                self._audio = AudioTrack(self._audio_from, self._output, self._container_name)
        except BaseException:
            self._abandon()
            raise
        return self

    def _add_stream(self) -> av.video.stream.VideoStream:
        info = self._info
        rate = info.frame_rate or Fraction(25)
        stream = self._output.add_stream(_ENCODERS[self.codec], rate=rate, options=self._options)
        assert isinstance(stream, av.video.stream.VideoStream)  # noqa: S101 - narrows the binding's union
        stream.time_base = self._time_base
        context = stream.codec_context
        context.time_base = self._time_base
        context.width, context.height, context.pix_fmt = self.width, self.height, self.format.name
        context.colorspace, context.color_range = self._tags.matrix, self._tags.color_range
        context.color_primaries, context.color_trc = self._tags.primaries, self._tags.transfer
        context.sample_aspect_ratio = info.sample_aspect_ratio
        context.bit_rate = 0
        context.thread_type = "AUTO"
        context.thread_count = self._threads
        if self.codec == "hevc" and self._container_name in ("mp4", "mov"):
            context.codec_tag = "hvc1"
        return stream

    def write(self, frame: Frame, patches: Sequence[Patch] = ()) -> None:
        """Encode one frame; frames come in display order with rising time stamps (ValueError otherwise).

        patches: laid over the frame's planes as these are copied for the encoder.
        """
        if frame.format != self._source_format or (frame.width, frame.height) != (self._info.width, self._info.height):
            raise ValueError(
                f"frame {frame.index} is {frame.width}x{frame.height} {frame.format.name}; the writer was made for "
                f"{self._info.width}x{self._info.height} {self._source_format.name}"
            )
        if self._last_pts is not None and frame.pts <= self._last_pts:
            raise ValueError(f"frame {frame.index}: time stamp {frame.pts} does not follow {self._last_pts}")
        if self._last_pts is None:
            self._first_pts = frame.pts
        self._last_pts = frame.pts
        picture = self._picture(frame, patches)
        self._end_pts = frame.pts + picture.duration
        try:
            self._mux(self._stream.encode(picture))
        except av.error.FFmpegError as error:
            raise self._failure(error) from error
        self._frames += 1

    def _picture(self, frame: Frame, patches: Sequence[Patch]) -> av.video.frame.VideoFrame:
        source = "gbrp" if frame.format.is_rgb else frame.format.name
        picture = av.video.frame.VideoFrame(self.width, self.height, source)
        for p, (component, plane) in enumerate(zip(picture.format.components[:3], frame.planes, strict=True)):
            target = picture.planes[component.plane]
            rows = np.frombuffer(memoryview(target), dtype=plane.dtype)
            rows = rows.reshape(-1, target.line_size // plane.dtype.itemsize)[: target.height, : target.width]
            rows[:] = plane[: target.height, : target.width]
            for patch in patches:
                if patch.plane == p:
                    patch.lay_over(rows)
        if source != self.format.name:
            picture = self._converted(picture, frame.format)
        picture.pts, picture.time_base = frame.pts, self._time_base
        picture.duration = frame.duration or self._step()
        picture.colorspace, picture.color_range = self._tags.matrix, self._tags.color_range
        picture.color_primaries, picture.color_trc = self._tags.primaries, self._tags.transfer
        return picture

    def _converted(self, picture: av.video.frame.VideoFrame, source: PixelFormat) -> av.video.frame.VideoFrame:
        full = RANGE_FULL if self.format.full_range else RANGE_LIMITED
        return picture.reformat(
            format=self.format.name,
            src_color_range=RANGE_FULL if source.is_rgb else full,
            dst_color_range=full,
            dst_colorspace=1 if source.is_rgb else None,
            interpolation="BICUBIC",
        )

    def _step(self) -> int:
        return max(1, round(1 / ((self._info.frame_rate or Fraction(25)) * self._time_base)))

    def _mux(self, packets: Sequence[_Packet]) -> None:
        for packet in packets:
            self._flush_held()
            self._held = packet

    def _flush_held(self) -> None:
        packet, self._held = self._held, None
        if packet is None:
            return
        if self._audio is not None and packet.dts is not None:
            self._audio.feed(packet.dts * packet.time_base)
        if self._first_dts is None:
            self._first_dts = packet.dts
        self._output.mux_one(packet)

    def _finish(self) -> None:
        self._mux(self._stream.encode(None))
        last = self._held
        if last is not None and last.dts is not None and last.time_base == self._time_base:
            # MP4 sums durations in coding order, so the last packet coded ends the clip, whichever it shows
            first_dts = last.dts if self._first_dts is None else self._first_dts
            last.duration = max(1, self._end_pts - self._first_pts - (last.dts - first_dts))
        self._flush_held()
        if self._audio is not None:
            self._audio.feed(None)
            self._audio.close()
        self._output.close()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._abandon()
            return
        try:
            if self._frames == 0:
                raise ValueError(f"{self.path.name}: no frame was written")
            self._finish()
        except av.error.FFmpegError as failed:
            self._abandon()
            raise self._failure(failed) from failed
        except BaseException:
            self._abandon()
            raise

    def _failure(self, error: av.error.FFmpegError) -> MediaError:
        return MediaError(
            f"{self.path.name}: {self.codec} encoding of {self.width}x{self.height} {self.format.name} failed at "
            f"frame {self._frames} ({reason(error)}); choose another codec or check the disk"
        )

    def _abandon(self) -> None:
        if self._audio is not None:
            self._audio.close()
        with suppress(av.error.FFmpegError, OSError, ValueError):  # what was written is thrown away anyway
            self._output.close()
        self.path.unlink(missing_ok=True)
