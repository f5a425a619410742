"""Decoded pictures as upright frames: what a clip's first picture fixes for all of them, and their planes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import av.video.frame
import numpy as np

from pvg.errors import MediaError
from pvg.video.color import color_space, named_space
from pvg.video.formats import (
    RANGE_FULL,
    RANGE_LIMITED,
    SCALER_THREADS,
    UNSPECIFIED,
    UNSTATED,
    Frame,
    PixelFormat,
    Plane,
    Planes,
    raise_chroma,
    resolve_format,
)
from pvg.video.opening import OpenClip
from pvg.video.side_data import side_data

_BT709 = 1
_FEW_BITS = tuple(f"{order}5{green}5{end}" for order in ("rgb", "bgr") for green in (5, 6) for end in ("le", "be"))


@dataclass(frozen=True)
class Orientation:
    """How a stored picture is turned upright: transpose, then flip rows, then flip columns.

    degrees: the clockwise turn, for people to read. asked: the one that the clip states, in [0, 360).
    """

    transpose: bool = False
    flip_rows: bool = False
    flip_columns: bool = False
    degrees: int = 0
    asked: float = 0.0

    @property
    def is_rounded(self) -> bool:
        """Whether the clip asks for no quarter turn; half a degree passes for one."""
        off = abs(self.asked - self.degrees) % 360
        return min(off, 360 - off) > 0.5

    def apply(self, plane: Plane) -> Plane:
        """The plane upright, not to be written to: itself when it is stored so, else contiguous."""
        if not (self.transpose or self.flip_rows or self.flip_columns):
            return plane
        turned = plane.T if self.transpose else plane
        rows, columns = (-1 if flip else 1 for flip in (self.flip_rows, self.flip_columns))
        upright: Plane = np.ascontiguousarray(turned[::rows, ::columns])  # type: ignore[assignment]
        upright.flags.writeable = False
        return upright


def orientation_of(frame: av.video.frame.VideoFrame) -> Orientation:
    """The frame's display matrix (x' = a x + c y, y' = b x + d y), rounded to quarter turns and mirrors."""
    raw = side_data(frame).get("DISPLAYMATRIX")
    if raw is None:
        return Orientation()
    a, b, _, c, d = (int(value) for value in np.frombuffer(raw, dtype=np.int32)[:5])
    asked = math.degrees(math.atan2(b, a)) % 360
    degrees = round(asked / 90.0) * 90 % 360
    if abs(a) + abs(d) >= abs(b) + abs(c):
        return Orientation(False, d < 0, a < 0, degrees, asked)
    return Orientation(True, b < 0, c < 0, degrees, asked)


@dataclass(frozen=True)
class DecodingPlan:
    """What the first frame fixes for all others of a clip.

    coded_size: (width, height) as coded, before rotation;  coded_format: libav's name of the layout;
    target: the format of the frames that come out;  orientation: how they are turned upright;
    matrix: the code point of ISO/IEC 23091-2 that the clip states, by its pictures or its container (2: none).
    """

    coded_size: tuple[int, int]
    coded_format: str
    target: PixelFormat
    orientation: Orientation
    matrix: int = UNSPECIFIED

    @property
    def upright_size(self) -> tuple[int, int]:
        """(width, height) after rotation."""
        width, height = self.coded_size
        return (height, width) if self.orientation.transpose else (width, height)


def _first_stated(*tags: int) -> int:
    """The first of some code points that says something; UNSPECIFIED where none does."""
    return next((tag for tag in tags if tag not in UNSTATED), UNSPECIFIED)


def decoding_plan(clip: OpenClip, frame: av.video.frame.VideoFrame, input_color: str = "auto") -> DecodingPlan:
    """The decoding plan of a clip whose first decoded picture is `frame`.

    input_color: one of `color.INPUT_COLORS`. Raises MediaError for unsupported colours.
    """
    context = clip.stream.codec_context
    color_range = frame.color_range or context.color_range or clip.colors.color_range
    matrix = _first_stated(frame.colorspace, context.colorspace, clip.colors.matrix)
    if matrix == _BT709 and context.name == "dnxhd":  # encoders leave it so where they do not say a picture's matrix
        matrix = _first_stated(clip.colors.matrix, matrix)
    try:
        if input_color == "auto":
            color = color_space(
                _first_stated(frame.color_primaries, context.color_primaries, clip.colors.primaries),
                _first_stated(frame.color_trc, context.color_trc, clip.colors.transfer),
            )
        else:
            color = named_space(input_color)
        target = resolve_format(frame.format.name, frame.width, frame.height, matrix, color_range, color)
    except MediaError as error:
        raise MediaError(f"{clip.name}: {error}") from error
    orientation = orientation_of(frame)
    if orientation.transpose and target.chroma_log2 == (1, 0):
        # A sideways 4:2:2 picture has no supported layout; 4:4:4 holds all of it
        name = target.name.replace("422", "444")
        target = replace(target, name=name, chroma_log2=(0, 0))
    return DecodingPlan((frame.width, frame.height), frame.format.name, target, orientation, matrix)


def to_frame(
    picture: av.video.frame.VideoFrame, plan: DecodingPlan, index: int, pts: int, time_base: Fraction
) -> Frame:
    """The planes of a decoded picture, turned upright."""
    stored = [plan.orientation.apply(plane) for plane in _stored_planes(picture, plan.target)]
    planes: Planes = (stored[0], stored[1], stored[2])
    alpha = plan.orientation.apply(_stored_alpha(picture, plan.target)) if has_alpha(picture) else None
    return Frame(index, pts, float(pts * time_base), plan.target, planes, duration=picture.duration or 0, alpha=alpha)


def within_depth(name: str, frame: Frame) -> Frame:
    """The frame of a clip, as it is. MediaError names it when a sample is beyond its depth, which tables end at.

    Decoders give none such; what is not coded, in pipes and in Matroska, holds any 16 bits.
    """
    depth, samples = frame.format.depth, [*frame.planes, *([] if frame.alpha is None else [frame.alpha])]
    if depth not in (8, 16) and any(int(plane.max(initial=0)) >> depth for plane in samples):
        raise MediaError(f"{name} has values beyond {depth} bits in frame {frame.index}; it is damaged")
    return frame


def has_alpha(picture: av.video.frame.VideoFrame) -> bool:
    """Whether a decoded picture comes with alpha; that of a palette does not count."""
    return any(component.is_alpha for component in picture.format.components)


def _stored_alpha(picture: av.video.frame.VideoFrame, target: PixelFormat) -> Plane:
    """(h, w) alpha in the samples of `target`, as stored."""
    last = picture.format.components[-1]
    if last.plane != 3 or last.bits != target.depth or picture.format.name.endswith("be"):
        digits = "" if target.depth == 8 else f"{target.depth}le"
        layout = ("gbrap" if target.is_rgb else "yuva444p") + digits
        picture = picture.reformat(format=layout, threads=SCALER_THREADS)
    return _plane_of(picture, 3, target)


def _stored_planes(picture: av.video.frame.VideoFrame, target: PixelFormat) -> list[Plane]:
    source = picture.format.name.replace("yuvj", "yuv")
    grey = source.startswith("gray") and len(picture.format.components) == 1
    if grey and source == ("gray" if target.depth == 8 else f"gray{target.depth}le"):
        shape = target.plane_shapes(picture.width, picture.height)[1]
        neutral: Plane = np.full(shape, 2 ** (target.depth - 1), dtype=target.dtype)  # type: ignore[assignment]
        return [_plane_of(picture, 0, target), neutral, neutral.copy()]
    if source == target.name.replace("444", "422") != target.name:  # a sideways 4:2:2 picture
        coded = replace(target, name=source, chroma_log2=(1, 0))
        luma, *chroma = (_plane_of(picture, component.plane, coded) for component in picture.format.components[:3])
        raised: list[Plane] = [raise_chroma(plane, coded, picture.width, picture.height) for plane in chroma]
        return [luma, *raised]
    if target.is_rgb and source in _FEW_BITS:  # the way to planes adds zeros to these bits, so that white is grey
        picture = picture.reformat(format="rgb24", threads=SCALER_THREADS)
    if source.replace("yuva", "yuv").replace("gbrap", "gbrp") != target.name:
        full = RANGE_FULL if target.full_range else RANGE_LIMITED
        picture = picture.reformat(
            format=target.name,
            # the matrix is kept; swscale only moves samples, except into RGB where its input is RGB too
            src_color_range=full,
            dst_color_range=full,
            interpolation="BICUBIC",
            threads=SCALER_THREADS,
        )
    return [_plane_of(picture, component.plane, target) for component in picture.format.components[:3]]


def _plane_of(picture: av.video.frame.VideoFrame, index: int, target: PixelFormat) -> Plane:
    """A plane in the decoder's own memory, which lives as long as the array; other pictures may need it: read-only."""
    plane = picture.planes[index]
    rows = np.frombuffer(plane, dtype=target.dtype)  # type: ignore[call-overload]
    stride = plane.line_size // np.dtype(target.dtype).itemsize
    view: Plane = rows.reshape(-1, stride)[: plane.height, : plane.width]
    view.flags.writeable = False
    return view
