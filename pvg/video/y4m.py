"""YUV4MPEG2, written and read: a line of text for the clip, and for each picture a line and its planes as they are.

The format is that of mjpegtools, yuv4mpeg(5); depths above 8 bits and "XCOLORRANGE" are as libav's tools write them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from types import TracebackType
from typing import BinaryIO

import numpy as np

from pvg.errors import MediaError
from pvg.video.decoding import within_depth
from pvg.video.encoders import FieldOrder
from pvg.video.formats import RANGE_FULL, Frame, Patch, PixelFormat, Plane
from pvg.video.info import MediaInfo
from pvg.video.plan import Plan
from pvg.video.stream_bytes import exactly, line

Y4M_START = b"YUV4MPEG2"
_RANGE_LIMITED = 1  # by H.273, as RANGE_FULL
_CHROMA = {(1, 1): "420", (1, 0): "422", (0, 0): "444"}
_LAYOUT = re.compile(r"(420|422|444)(jpeg|mpeg2|paldv)?(?:p(10|12))?$")
_INTERLACED: dict[str, FieldOrder] = {"t": "tff", "b": "bff"}


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
        self._head = f"{Y4M_START.decode()} {' '.join(words)}\n".encode()
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
            samples = np.ascontiguousarray(plane, dtype=plane.dtype.newbyteorder("<"))
            self._target.write(samples.data.cast("B"))  # streams count what they are given by its length
        self._frames += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and self._frames == 0:
            raise ValueError("the output: no frame was written")
        if kind is None:
            self._target.flush()


@dataclass(frozen=True)
class Y4mHeader:
    """What the first line says of a clip.

    layout: libav's name of the planes;  color_range: by H.273, None where it is not said;  aspect: of a pixel;
    fields: None for progressive or not said;  progressive: whether it says that.
    """

    width: int
    height: int
    frame_rate: Fraction
    aspect: Fraction
    layout: str
    color_range: int | None
    fields: FieldOrder | None
    progressive: bool

    @classmethod
    def parse(cls, name: str, head: bytes) -> Y4mHeader:
        """The header of a first line;  name: of the stream. Raises MediaError for what cannot be read."""
        words = head.decode("ascii", "replace").split()[1:]
        told = {word[0]: word[1:] for word in words if word[0] != "X"}
        try:
            width, height = int(told["W"]), int(told["H"])
            rate = Fraction(*map(int, told["F"].split(":")))
            aspect = Fraction(*map(int, told["A"].split(":"))) if told.get("A", "0:0") != "0:0" else Fraction(1)
            if rate <= 0 or aspect <= 0 or width < 1 or height < 1:
                raise ValueError("nothing to see")
        except (KeyError, ValueError, TypeError, ZeroDivisionError) as error:
            raise MediaError(f"{name}: the first line of YUV4MPEG2 cannot be read") from error
        layout = _LAYOUT.match(told.get("C", "420"))
        if layout is None:
            raise MediaError(f"{name} is YUV4MPEG2 {told['C']}; taken are 420, 422 and 444 of 8, 10 or 12 bits")
        planes = f"yuv{layout[1]}p" + (f"{layout[3]}le" if layout[3] else "")
        ranges = {"XCOLORRANGE=FULL": RANGE_FULL, "XCOLORRANGE=LIMITED": _RANGE_LIMITED}
        stated = next((code for word, code in ranges.items() if word in words), None)
        scan = told.get("I", "p")
        return cls(width, height, rate, aspect, planes, stated, _INTERLACED.get(scan), told.get("I") == "p")


def y4m_frames(name: str, source: BinaryIO, begun: bytes, target: PixelFormat, header: Y4mHeader) -> Iterator[Frame]:
    """The frames of a stream after its first line;  begun: what of them was read with it;  target: their format.

    Raises MediaError for damaged data, name: of the stream.
    """
    shapes = target.plane_shapes(header.width, header.height)
    step, index = 1 / header.frame_rate, 0
    while True:
        mark = begun if begun.endswith(b"\n") else begun + line(source)
        begun = b""
        if not mark:
            return
        if not mark.startswith(b"FRAME") or not mark.endswith(b"\n"):
            raise MediaError(f"{name} is damaged after frame {index}")
        first, second, third = (_plane(name, source, shape, target, index) for shape in shapes)
        frame = Frame(index, index, float(index * step), target, (first, second, third), duration=1)
        yield within_depth(name, frame)
        index += 1


def _plane(name: str, source: BinaryIO, shape: tuple[int, int], target: PixelFormat, index: int) -> Plane:
    data = exactly(source, shape[0] * shape[1] * np.dtype(target.dtype).itemsize)
    if not data:
        raise MediaError(f"{name} ends within frame {index}")
    plane: Plane = np.frombuffer(data, dtype=target.dtype).reshape(shape)  # type: ignore[assignment]
    return plane
