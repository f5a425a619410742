"""Clips that come by a pipe: YUV4MPEG2 read by `y4m`, NUT by libav."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import av
import av.container
import av.error

from pvg._processors import decoding_threads
from pvg.errors import MediaError
from pvg.video.color import ColorSpace
from pvg.video.decoding import DecodingPlan, decoding_plan, has_alpha, to_frame, within_depth
from pvg.video.encoders import FieldOrder
from pvg.video.formats import UNSPECIFIED, Frame, PixelFormat, resolve_format
from pvg.video.opening import MediaLimits, OpenClip, reason
from pvg.video.reading import pictures
from pvg.video.sniffing import check_pixels
from pvg.video.stream_bytes import exactly, line
from pvg.video.y4m import Y4M_START, Y4mHeader, y4m_frames

_NUT_START = b"nut/multimedia container\0"


@dataclass(frozen=True)
class PipedClip:
    """A clip that is read once, as it comes.

    pixel_format: the libav name as coded, of what the frames come in `format`;
    fields: as the pipe says, None for progressive or not said;  progressive: whether it says that;  has_alpha: whether
    its frames come with an alpha plane;  stamped: whether they come with time stamps, and not at an even rate.
    """

    name: str
    width: int
    height: int
    frame_rate: Fraction
    time_base: Fraction
    pixel_format: str
    format: PixelFormat
    frames: Iterator[Frame]
    fields: FieldOrder | None = None
    sample_aspect_ratio: Fraction = Fraction(1)
    progressive: bool = False
    has_alpha: bool = False
    stamped: bool = True


class PipeReader:
    """Opens NUT or YUV4MPEG2 that comes by a binary stream; a context manager that gives a `PipedClip`.

    source: called by its name in messages, or standard input, if it is that;
    color: (matrix, range) by H.273 where the pipe does not say, which it rarely does; space: what R'G'B' stands for.
    Raises MediaError for other formats and damaged data, also while frames are taken.
    """

    def __init__(
        self,
        source: BinaryIO,
        color: tuple[int, int] = (2, 0),
        space: ColorSpace | None = None,
        limits: MediaLimits | None = None,
    ) -> None:
        self._source, self._color, self._space, self._limits = source, color, space, limits or MediaLimits()
        self._name = _name_of(source)

    def __enter__(self) -> PipedClip:
        with ExitStack() as stack:
            clip = self._clip(exactly(self._source, len(_NUT_START), short=True), stack)
            self._opened = stack.pop_all()
        return clip

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def _clip(self, start: bytes, stack: ExitStack) -> PipedClip:
        if start.startswith(Y4M_START):
            return self._y4m(start)
        if start == _NUT_START:
            return self._nut(start, stack)
        raise MediaError(f"{self._name} is neither NUT nor YUV4MPEG2")

    def _y4m(self, start: bytes) -> PipedClip:
        begun = start + line(self._source) if b"\n" not in start else start
        head, _, rest = begun.partition(b"\n")
        header = Y4mHeader.parse(self._name, head)
        check_pixels(self._name, header.width, header.height, self._limits.max_pixels)
        matrix, usual_range = self._color
        color_range = usual_range if header.color_range is None else header.color_range
        target = resolve_format(header.layout, header.width, header.height, matrix, color_range, self._space)
        return PipedClip(
            name=self._name,
            width=header.width,
            height=header.height,
            frame_rate=header.frame_rate,
            time_base=1 / header.frame_rate,
            pixel_format=header.layout,
            format=target,
            frames=y4m_frames(self._name, self._source, rest, target, header),
            fields=header.fields,
            sample_aspect_ratio=header.aspect,
            progressive=header.progressive,
            stamped=False,
        )

    def _nut(self, start: bytes, stack: ExitStack) -> PipedClip:
        try:
            opened = av.open(_Joined(start, self._source), "r", format="nut")
        except (av.error.FFmpegError, ValueError) as error:
            raise MediaError(f"{self._name} is damaged: its header cannot be read ({reason(error)})") from error
        container: av.container.InputContainer = stack.enter_context(opened)
        if not container.streams.video:
            raise MediaError(f"{self._name} has no pictures")
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        clip = OpenClip(self._name, container, stream)
        context = stream.codec_context
        context.thread_count = decoding_threads()
        check_pixels(clip.name, context.width, context.height, self._limits.max_pixels)
        matrix, stated = self._color
        if context.colorspace == UNSPECIFIED:
            context.colorspace, context.color_range = matrix, context.color_range or stated
        decoded = pictures(clip)
        first = next(decoded, None)
        if first is None:
            raise MediaError(f"{self._name} holds no frame that can be decoded")
        plan = decoding_plan(clip, first, "sdr")
        plan = replace(plan, target=replace(plan.target, color=self._space))
        rate = stream.average_rate or stream.guessed_rate or Fraction(25)
        frames = self._nut_frames(clip, chain([first], decoded), plan)
        aspect = stream.sample_aspect_ratio or Fraction(1)
        width, height = plan.upright_size
        return PipedClip(
            name=clip.name,
            width=width,
            height=height,
            frame_rate=rate,
            time_base=clip.time_base,
            pixel_format=plan.coded_format,
            format=plan.target,
            frames=frames,
            sample_aspect_ratio=aspect,
            has_alpha=has_alpha(first),
        )

    def _nut_frames(self, clip: OpenClip, decoded: Iterator[Any], plan: DecodingPlan) -> Iterator[Frame]:
        last: int | None = None
        for index, picture in enumerate(decoded):
            if (picture.width, picture.height, picture.format.name) != (*plan.coded_size, plan.coded_format):
                raise MediaError(f"{self._name} changes its pictures' size or format at frame {index}")
            pts = picture.pts if picture.pts is not None else index
            pts = pts if last is None or pts > last else last + 1
            last = pts
            yield within_depth(clip.name, to_frame(picture, plan, index, pts, clip.time_base))


def _name_of(source: BinaryIO) -> str:
    """What a stream is called in messages."""
    name = getattr(source, "name", None)
    if name in (0, "<stdin>"):
        return "standard input"
    return Path(name).name if isinstance(name, str) else "the stream of pictures"


class _Joined:
    """A stream whose first bytes were already read."""

    def __init__(self, begun: bytes, rest: BinaryIO) -> None:
        self._begun, self._rest = begun, rest

    def read(self, size: int) -> bytes:
        """At most `size` bytes; none at the end."""
        if self._begun:
            taken, self._begun = self._begun[:size], self._begun[size:]
            return taken
        return self._rest.read(size)
