"""Packets of frames: what a clip's encoder is given, and what comes out of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

import av.codec.context
import av.container
import av.error
import av.packet
import av.video.codeccontext
import av.video.frame
import av.video.stream

from pvg.errors import MediaError
from pvg.video.encoders import (
    ENCODERS,
    encoder_options,
    encoder_threads,
    format_options,
    joined,
    layout_of,
    part_options,
    planar_layout,
)
from pvg.video.fields import FieldMarks, field_of, rows_of
from pvg.video.formats import RANGE_FULL, RANGE_LIMITED, SCALER_THREADS, Frame, Patch, PixelFormat
from pvg.video.info import MediaInfo
from pvg.video.keeping import stated_colors
from pvg.video.opening import reason
from pvg.video.plan import Plan
from pvg.video.scheduling import kept_scheduling

CodedPacket: TypeAlias = "av.packet.Packet[av.video.stream.VideoStream]"

_FIELD_ORDERS = {"h264": {"tff": 2, "bff": 3}}  # AVFieldOrder as x264's own marks are read back
_FIELD_ORDER = {"tff": 4, "bff": 5}  # interleaved lines, as libav's tools write it
_COPYING = ("h264", "hevc")  # x264 and x265 have copied a picture when it was handed over
_COLOR_VOLUME = 0x2C  # the byte of a DNxHR picture's head, of which two bits say it (SMPTE ST 2019-1)
_COLOR_VOLUMES = {1: 0, 9: 1, 10: 2}  # BT.709, BT.2020 non-constant and constant luminance by H.273; else 3


@dataclass(frozen=True)
class _Tags:
    """Colour code points of ISO/IEC 23091-2 as they are written."""

    matrix: int
    color_range: int
    primaries: int
    transfer: int


def _tags(info: MediaInfo, source: PixelFormat, target: PixelFormat, codec: str) -> _Tags:
    if target.is_rgb:
        return _Tags(0, RANGE_FULL, info.color_primaries, info.color_transfer)
    if source.is_rgb:
        return _Tags(1, RANGE_LIMITED, info.color_primaries, info.color_transfer)
    # An unstated limited range stays unstated, so that players make the same guess as before
    color_range = RANGE_FULL if target.full_range else info.color_range
    if not target.full_range and (source.full_range or color_range == RANGE_FULL):
        color_range = RANGE_LIMITED
    stated = stated_colors(info, codec)
    return _Tags(stated.matrix, color_range, stated.primaries, stated.transfer)


def _say_matrix(packet: CodedPacket, matrix: int) -> None:
    """Write a DNxHR picture's matrix into it: libav leaves those bits as they are for BT.709."""
    data = memoryview(packet)
    data[_COLOR_VOLUME] = data[_COLOR_VOLUME] & ~6 | _COLOR_VOLUMES.get(matrix, 3) << 1


def decoding_times(stamps: Sequence[int], delay: int) -> Iterator[int]:
    """Decode time stamps of all packets of a clip in coding order, as x264 and x265 give them.

    stamps: of the frames in order of display;  delay: see `reordering_delay`.

    The i-th packet has the stamp s[i - d] of the frame that is shown d places before, the first d s[i] - (s[d] - s[0]).
    They rise, and none is later than its packet's frame, since no packet stands more than d places behind that.
    """
    ahead = stamps[min(delay, len(stamps) - 1)] - stamps[0]
    for k in range(len(stamps)):
        yield stamps[k - delay] if k >= delay else stamps[k] - ahead


def reordering_delay(shown: Sequence[int]) -> int:
    """By how many places a packet stands behind its frame's at most;  shown: the frames' time stamps as coded."""
    place = {pts: k for k, pts in enumerate(sorted(shown))}
    return max((k - place[pts] for k, pts in enumerate(shown)), default=0)


class PictureEncoder:
    """Makes packets of frames, in coding order, with the frames' time stamps in the source clip's time base.

    info: the source clip's; its time base, frame rate, colour tags and pixel aspect are kept. format: that of the
    frames to come. plan: codec, format and size of the pictures, see `make_plan`. crf, preset, threads: see
    `VideoWriter`. name: of what is made, in messages. It encodes as a stream of a file, by `stream_of`.
    part: of packets that stand beside those of other encoders in one clip: one thread, as the same bytes are wanted on
    every machine, and no group of pictures that needs another.

    Raises ValueError for options that do not fit, MediaError when encoding fails.
    """

    def __init__(
        self,
        info: MediaInfo,
        format: PixelFormat,  # noqa: A002 - the name callers know from Frame
        plan: Plan,
        *,
        crf: int | None = None,
        preset: str | None = None,
        threads: int = 0,
        part: bool = False,
        name: str = "the output",
    ) -> None:
        if info.time_base is None:
            raise ValueError("a still picture has no time base; write it with write_image")
        further = format_options(
            plan.codec,
            plan.format,
            (plan.width, plan.height),
            alpha=plan.alpha,
            fields=plan.fields,
            mastering=plan.mastering,
            light=plan.light,
        )
        self.plan, self.time_base, self.frames = plan, info.time_base, 0
        self._options = joined(encoder_options(plan.codec, crf, preset), further)
        self._threads, by_threads = (1, part_options(plan.codec)) if part else encoder_threads(plan.codec, threads)
        self._options = joined(self._options, by_threads)
        self._source_format, self._info, self._name, self._part = format, info, name, part
        self._tags = _tags(info, format, plan.format, plan.codec)
        self._marked = None if plan.fields is None else FieldMarks(plan.fields)
        self._last_pts: int | None = None
        self._filled: av.video.frame.VideoFrame | None = None
        self._coded = False
        self.first_pts = self.end_pts = 0
        """Where the first frame starts and the last one ends, in ticks."""

    def stream_of(self, output: av.container.OutputContainer) -> av.video.stream.VideoStream:
        """The stream of a new file that the packets are for: it says what they are, and encodes them."""
        info, plan = self._info, self.plan
        rate = info.frame_rate or Fraction(25)
        stream = output.add_stream(ENCODERS[plan.codec].library, rate=rate, options=self._options)
        assert isinstance(stream, av.video.stream.VideoStream)  # noqa: S101 - narrows the binding's union
        stream.time_base = self.time_base
        context = self._context = stream.codec_context
        context.time_base = self.time_base
        context.width, context.height = plan.width, plan.height
        context.pix_fmt = layout_of(plan.format, plan.codec, alpha=plan.alpha)
        context.colorspace, context.color_range = self._tags.matrix, self._tags.color_range
        context.color_primaries, context.color_trc = self._tags.primaries, self._tags.transfer
        context.sample_aspect_ratio = info.sample_aspect_ratio
        context.bit_rate = 0
        context.thread_type = "AUTO"
        context.thread_count = self._threads
        if self._part:
            context.flags |= av.codec.context.Flags.closed_gop
        if plan.fields is not None:
            context.flags |= av.codec.context.Flags.interlaced_dct | av.codec.context.Flags.interlaced_me
            context.field_order = _FIELD_ORDERS.get(plan.codec, _FIELD_ORDER)[plan.fields]
        if plan.codec == "hevc" and plan.container in ("mp4", "mov"):
            context.codec_tag = "hvc1"
        return stream

    def head(self) -> bytes:
        """What decoders are told before the first packet (libav's extradata); empty where there is no such thing."""
        self._open()
        return self._context.extradata or b""

    def _open(self) -> None:
        if not self._context.is_open:
            with kept_scheduling():
                self._context.open(strict=False)

    def encode(self, frame: Frame, patches: Sequence[Patch] = (), *, closing: bool = False) -> list[CodedPacket]:
        """The packets that one frame completes; see `VideoWriter.write`. closing: the last frame of a part."""
        if frame.format != self._source_format or (frame.width, frame.height) != (self._info.width, self._info.height):
            raise ValueError(
                f"frame {frame.index} is {frame.width}x{frame.height} {frame.format.name}; the writer was made for "
                f"{self._info.width}x{self._info.height} {self._source_format.name}"
            )
        if self._last_pts is not None and frame.pts <= self._last_pts:
            raise ValueError(f"frame {frame.index}: time stamp {frame.pts} does not follow {self._last_pts}")
        if self._last_pts is None:
            self.first_pts = frame.pts
        self._last_pts = frame.pts
        picture = self._picture(frame, patches)
        if closing and self.plan.codec == "h264" and self.frames > 0:
            # two IDR pictures side by side need two values of idr_pic_id (H.264, 7.4.3), and every part starts at 0
            picture.pict_type = av.video.frame.PictureType.P
        self.end_pts = frame.pts + picture.duration
        packets = self._encoded(picture)
        self.frames += 1
        return packets

    def rest(self) -> list[CodedPacket]:
        """The packets that are left when no more frames come."""
        none_before = not self._coded
        packets = self._encoded(None)
        if self.plan.codec == "hevc" and none_before:
            # x265 leaves those of a clip with no more frames than its reordering delay uninitialised
            shown = [packet.pts for packet in packets if packet.pts is not None]
            for packet, time in zip(packets, decoding_times(sorted(shown), reordering_delay(shown)), strict=True):
                packet.dts = time
        return packets

    def _encoded(self, picture: av.video.frame.VideoFrame | None) -> list[CodedPacket]:
        try:
            self._open()
            packets = self._context.encode(picture)
        except av.error.FFmpegError as error:
            raise self.failure(error) from error
        if self.plan.codec == "dnxhr":
            for packet in packets:
                _say_matrix(packet, self._tags.matrix)
        self._coded = self._coded or bool(packets)
        return packets

    def failure(self, error: av.error.FFmpegError) -> MediaError:
        """What to raise when encoding or writing fails."""
        plan = self.plan
        return MediaError(
            f"{self._name}: {plan.codec} encoding of {plan.width}x{plan.height} {plan.format.name} failed at "
            f"frame {self.frames} ({reason(error)}); choose another codec or check the disk"
        )

    def _picture(self, frame: Frame, patches: Sequence[Patch]) -> av.video.frame.VideoFrame:
        alpha = self.plan.alpha
        source = planar_layout(frame.format, alpha=alpha)
        picture = self._blank(source)
        for p, (component, plane) in enumerate(zip(picture.format.components[:3], frame.planes, strict=True)):
            rows = rows_of(picture, component.plane, plane.dtype)
            rows[:] = plane[: rows.shape[0], : rows.shape[1]]
            for patch in patches:
                if patch.plane == p:
                    patch.lay_over(rows)
        if alpha:
            rows = rows_of(picture, picture.format.components[3].plane, frame.planes[0].dtype)
            opaque = 2**frame.format.depth - 1
            rows[:] = opaque if frame.alpha is None else frame.alpha[: rows.shape[0], : rows.shape[1]]
        if source != layout_of(self.plan.format, self.plan.codec, alpha=alpha):
            picture = self._converted(picture, frame.format)
        picture.pts, picture.time_base = frame.pts, self.time_base
        picture.duration = frame.duration or self._step()
        picture.colorspace, picture.color_range = self._tags.matrix, self._tags.color_range
        picture.color_primaries, picture.color_trc = self._tags.primaries, self._tags.transfer
        return picture if self._marked is None else self._marked(picture)

    def _blank(self, layout: str) -> av.video.frame.VideoFrame:
        """A picture to be filled: the one before again, where nobody holds it any more."""
        if self._filled is None or self.plan.codec not in _COPYING:
            self._filled = av.video.frame.VideoFrame(self.plan.width, self.plan.height, layout)
        self._filled.make_writable()  # of a copy, should anybody hold it
        return self._filled

    def _converted(self, picture: av.video.frame.VideoFrame, source: PixelFormat) -> av.video.frame.VideoFrame:
        if self.plan.fields is None or source.chroma_log2[1] == self.plan.format.chroma_log2[1]:
            return self._reformatted(picture, source)
        fields = [self._reformatted(field_of(picture, first), source) for first in (0, 1)]
        whole = av.video.frame.VideoFrame(self.plan.width, self.plan.height, fields[0].format.name)
        for first, field in enumerate(fields):
            for p in range(len(whole.planes)):
                rows = rows_of(whole, p, self.plan.format.dtype)[first::2]
                rows[:] = rows_of(field, p, self.plan.format.dtype)[: len(rows)]
        return whole

    def _reformatted(self, picture: av.video.frame.VideoFrame, source: PixelFormat) -> av.video.frame.VideoFrame:
        return picture.reformat(
            format=layout_of(self.plan.format, self.plan.codec, alpha=self.plan.alpha),
            src_color_range=RANGE_FULL if source.is_rgb or source.full_range else RANGE_LIMITED,
            dst_color_range=RANGE_FULL if self.plan.format.full_range else RANGE_LIMITED,
            dst_colorspace=1 if source.is_rgb and not self.plan.format.is_rgb else None,
            interpolation="BICUBIC",
            threads=SCALER_THREADS,
        )

    def _step(self) -> int:
        return max(1, round(1 / ((self._info.frame_rate or Fraction(25)) * self.time_base)))
