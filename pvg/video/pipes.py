"""Clips by a pipe: YUV4MPEG2 written and read here, NUT by libav.

YUV4MPEG2 is a line of text for the clip, and for each picture a line and its planes as they are (the format of
mjpegtools, yuv4mpeg(5); depths above 8 bits and "XCOLORRANGE" as libav's tools write them).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import av
import av.container
import av.error
import numpy as np

from pvg._processors import decoding_threads
from pvg.errors import MediaError
from pvg.video.color import ColorSpace
from pvg.video.decoding import DecodingPlan, decoding_plan, has_alpha, to_frame, within_depth
from pvg.video.encoders import FieldOrder
from pvg.video.formats import RANGE_FULL, UNSPECIFIED, Frame, Patch, PixelFormat, Plane, resolve_format
from pvg.video.info import MediaInfo
from pvg.video.keeping import Plan
from pvg.video.opening import MediaLimits, OpenClip, reason
from pvg.video.reading import pictures
from pvg.video.sniffing import check_pixels

_Y4M_START = b"YUV4MPEG2"
_NUT_START = b"nut/multimedia container\0"
_LONGEST_LINE = 4096
_CHROMA = {(1, 1): "420", (1, 0): "422", (0, 0): "444"}
_LAYOUT = re.compile(r"(420|422|444)(jpeg|mpeg2|paldv)?(?:p(10|12))?$")
_INTERLACED = {"t": "tff", "b": "bff"}


class Y4mWriter:
    """Writes frames as YUV4MPEG2 to a binary stream; a context manager like `VideoWriter`.

    format: of the frames, Y'CbCr of 8, 10 or 12 bits; alpha is left out. The frame rate is info's, 25 without one.
    """

    def __init__(self, target: BinaryIO, info: MediaInfo, format: PixelFormat, plan: Plan) -> None:  # noqa: A002
        rate, aspect = info.frame_rate or Fraction(25), info.sample_aspect_ratio
        depth = "" if format.depth == 8 else f"p{format.depth}"
        chroma = _CHROMA[format.chroma_log2] + ("mpeg2" if not depth and format.chroma_log2 == (1, 1) else depth)
        marks = {"tff": "t", "bff": "b", None: "p"}
        words = [
            f"W{info.width} H{info.height} F{rate.numerator}:{rate.denominator} I{marks[plan.fields]}",
            f"A{aspect.numerator}:{aspect.denominator} C{chroma}",
            f"XCOLORRANGE={'FULL' if format.full_range else 'LIMITED'}",
        ]
        self._head = f"{_Y4M_START.decode()} {' '.join(words)}\n".encode()
        self._target, self._format, self._frames = target, format, 0

    def __enter__(self) -> Y4mWriter:
        self._target.write(self._head)
        return self

    def write(self, frame: Frame, patches: Sequence[Patch] = ()) -> None:
        """Write one frame with patches laid over it, in display order. ValueError for one of another format."""
        if frame.format != self._format:
            raise ValueError(f"frame {frame.index} is {frame.format.name}; the writer was made for {self._format.name}")
        self._target.write(b"FRAME\n")
        for plane in frame.patched(patches).planes:
            self._target.write(np.ascontiguousarray(plane, dtype=plane.dtype.newbyteorder("<")).data)
        self._frames += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and self._frames == 0:
            raise ValueError("the output: no frame was written")
        if kind is None:
            self._target.flush()


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
            clip = self._clip(_exactly(self._source, len(_NUT_START), short=True), stack)
            self._opened = stack.pop_all()
        return clip

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def _clip(self, start: bytes, stack: ExitStack) -> PipedClip:
        if start.startswith(_Y4M_START):
            return self._y4m(start)
        if start == _NUT_START:
            return self._nut(start, stack)
        raise MediaError(f"{self._name} is neither NUT nor YUV4MPEG2")

    def _y4m(self, start: bytes) -> PipedClip:
        line = start + _line(self._source) if b"\n" not in start else start
        head, _, rest = line.partition(b"\n")
        words = head.decode("ascii", "replace").split()[1:]
        told = {word[0]: word[1:] for word in words if word[0] != "X"}
        try:
            width, height = int(told["W"]), int(told["H"])
            rate = Fraction(*map(int, told["F"].split(":")))
            aspect = Fraction(*map(int, told["A"].split(":"))) if told.get("A", "0:0") != "0:0" else Fraction(1)
            if rate <= 0 or aspect <= 0 or width < 1 or height < 1:
                raise ValueError("nothing to see")
        except (KeyError, ValueError, TypeError, ZeroDivisionError) as error:
            raise MediaError(f"{self._name}: the first line of YUV4MPEG2 cannot be read") from error
        layout = _LAYOUT.match(told.get("C", "420"))
        if layout is None:
            raise MediaError(f"{self._name} is YUV4MPEG2 {told['C']}; taken are 420, 422 and 444 of 8, 10 or 12 bits")
        check_pixels(self._name, width, height, self._limits.max_pixels)
        matrix, stated = self._color
        stated = RANGE_FULL if "XCOLORRANGE=FULL" in words else 1 if "XCOLORRANGE=LIMITED" in words else stated
        name = f"yuv{layout[1]}p" + (f"{layout[3]}le" if layout[3] else "")
        target = resolve_format(name, width, height, matrix, stated, self._space)
        fields: Any = _INTERLACED.get(told.get("I", "p"))
        frames = self._y4m_frames(target, (width, height), 1 / rate, rest)
        return PipedClip(
            *(self._name, width, height, rate, 1 / rate, name, target, frames),
            fields=fields,
            sample_aspect_ratio=aspect,
            progressive=told.get("I") == "p",
            stamped=False,
        )

    def _y4m_frames(self, target: PixelFormat, size: tuple[int, int], step: Fraction, begun: bytes) -> Iterator[Frame]:
        shapes = target.plane_shapes(*size)
        index = 0
        while True:
            mark = begun + _line(self._source)
            begun = b""
            if not mark:
                return
            if not mark.startswith(b"FRAME") or not mark.endswith(b"\n"):
                raise MediaError(f"{self._name} is damaged after frame {index}")
            first, second, third = (self._plane(shape, target, index) for shape in shapes)
            frame = Frame(index, index, float(index * step), target, (first, second, third), duration=1)
            yield within_depth(self._name, frame)
            index += 1

    def _plane(self, shape: tuple[int, int], target: PixelFormat, index: int) -> Plane:
        data = _exactly(self._source, shape[0] * shape[1] * np.dtype(target.dtype).itemsize)
        if not data:
            raise MediaError(f"{self._name} ends within frame {index}")
        plane: Plane = np.frombuffer(data, dtype=target.dtype).reshape(shape)  # type: ignore[assignment]
        return plane

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
            *(clip.name, width, height, rate, clip.time_base, plan.coded_format, plan.target, frames),
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


def _exactly(source: BinaryIO, size: int, *, short: bool = False) -> bytes:
    """`size` bytes; fewer only when `short` is allowed, else none where the stream ends before."""
    parts: list[bytes] = []
    left = size
    while left:
        part = source.read(left)
        if not part:
            return b"".join(parts) if short else b""
        parts.append(part)
        left -= len(part)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _line(source: BinaryIO) -> bytes:
    """The bytes up to the end of the line, and it; empty at the end of the stream."""
    found = bytearray()
    while len(found) < _LONGEST_LINE:
        byte = source.read(1)
        found += byte
        if not byte or byte == b"\n":
            break
    return bytes(found)
