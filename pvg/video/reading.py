"""Frames out of a clip: upright, exact in time, streamed."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import av
import av.error
import av.sidedata.sidedata
import av.video.frame
import numpy as np

from pvg.errors import MediaError, TooLongError
from pvg.video.color import color_space, named_space
from pvg.video.display_order import DisplayOrder, display_order
from pvg.video.formats import (
    RANGE_FULL,
    RANGE_LIMITED,
    UNSPECIFIED,
    UNSTATED,
    Frame,
    PixelFormat,
    Plane,
    Planes,
    raise_chroma,
    resolve_format,
)
from pvg.video.images import read_image
from pvg.video.opening import MediaLimits, OpenClip, open_clip, reason
from pvg.video.sniffing import IMAGE_KINDS, check_pixels, sniff
from pvg.video.stated import Stated

_BT709 = 1
_NO_END = 1 << 62
_ONE_FRAME_A_PACKET = ("h264", "hevc", "mjpeg", "mpeg4", "prores", "png")


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
    raw: Any = cast(Any, frame.side_data).get(av.sidedata.sidedata.Type.DISPLAYMATRIX)
    if raw is None:
        return Orientation()
    a, b, _, c, d = (int(value) for value in np.frombuffer(bytes(raw), dtype=np.int32)[:5])
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


@dataclass(frozen=True)
class _ReadOptions:
    """How a clip is to be read; see `read_frames`."""

    limits: MediaLimits
    input_color: str
    strict: bool
    notice: Callable[[str], None] | None = None


def read_frames(
    path: str | Path,
    *,
    start: int = 0,
    stop: int | None = None,
    limits: MediaLimits | None = None,
    input_color: str = "auto",
    strict: bool = False,
    frame_count: int | None = None,
    notice: Callable[[str], None] | None = None,
) -> Iterator[Frame]:
    """Yield the upright frames [start, stop) of a clip in display order, or the one frame of a picture.

    Frames are decoded as they are asked for. Layouts other than planar Y'CbCr 4:2:0, 4:2:2, 4:4:4 at 8, 10 or
    12 bits are converted to the nearest of these or to R, G, B planes of 8, 10, 12 or 16 bits; alpha comes along;
    interlaced frames come as coded. Time stamps are the container's (one that does not increase is raised to its
    predecessor's + 1).
    A clip whose end is cut off gives its whole frames up to there; strict: it is refused, and so is one that changes
    its colour tags, or from progressive to interlaced pictures, which are all read as the first one. notice: is told
    of that, in a line, where frames are read from the start.
    frame_count: how many frames reading from the start gives, where that is known: where packets tell of another
    number, as some decoders skip pictures, frames are counted by decoding all before them.
    input_color: one of `color.INPUT_COLORS`, for clips whose tags do not say how they are coded.
    Raises MediaError, also in mid-clip: damaged data, a changed picture size, a limit passed.
    """
    path = Path(path)
    options = _ReadOptions(limits or MediaLimits(), input_color, strict, notice)
    if start < 0 or (stop is not None and stop < start):
        raise ValueError(f"frames [{start}, {stop}) are not a range")
    if stop == start:
        return
    if sniff(path) in IMAGE_KINDS:
        if start == 0:
            yield read_image(path, options.limits, input_color)
        return
    wanted = range(start, _NO_END if stop is None else stop)
    if start > 0:
        order = display_order(path, options.limits, frame_count)
        if order is not None:
            yield from _read_from(path, wanted, options, order)
            return
    with open_clip(path, options.limits) as clip:
        yield from _decode(clip, wanted, options)


def _decode(clip: OpenClip, wanted: range, options: _ReadOptions) -> Iterator[Frame]:
    plan: DecodingPlan | None = None
    index, last, first = 0, None, None
    stated: Stated | None = None
    for picture in pictures(clip, strict=options.strict):
        if plan is None:
            plan, stated = decoding_plan(clip, picture, options.input_color), Stated.of(picture)
        if stated is not None and (change := stated.change_to(Stated.of(picture))) is not None:
            line, stated = f"{change} at frame {index}", None
            if options.strict:
                raise MediaError(f"{clip.name} {line}; re-encode it in one way")
            if options.notice is not None:
                options.notice(f"it {line}: all is read as its first picture")
        check_picture(clip.name, picture, plan, index, options.limits)
        pts = _stamp(clip, picture, last)
        first = pts if first is None else first
        if (pts - first) * clip.time_base > options.limits.max_duration_s:
            most_s = options.limits.max_duration_s
            raise TooLongError(f"{clip.name} runs past {most_s} s at frame {index}; cut it shorter", most_s, "seconds")
        if index in wanted:
            yield within_depth(clip.name, to_frame(picture, plan, index, pts, clip.time_base))
        last, index = pts, index + 1
        if index >= wanted.stop:
            return
    if index == 0:
        raise MediaError(f"{clip.name} holds no frame that can be decoded; it is damaged or empty")


def _read_from(path: Path, wanted: range, options: _ReadOptions, order: DisplayOrder) -> Iterator[Frame]:
    """Frames from wanted.start by way of the key picture before it; else by decoding from the beginning."""
    if wanted.start >= len(order.stamps):
        return
    before = bisect_right(order.keys, order.stamps[wanted.start]) - 1
    if before >= 0:
        done = False
        with open_clip(path, options.limits) as clip:
            for frame in _decode_after_seek(clip, wanted, options, order, order.keys[before]):
                yield frame
                done = True
        if done:
            return
    with open_clip(path, options.limits) as clip:
        yield from _decode(clip, wanted, options)


def _decode_after_seek(
    clip: OpenClip, wanted: range, options: _ReadOptions, order: DisplayOrder, key: int
) -> Iterator[Frame]:
    # How the clip looks is fixed by its first frame, wherever reading begins
    opening = next(pictures(clip), None)
    if opening is None:
        return
    plan = decoding_plan(clip, opening, options.input_color)
    try:
        clip.seek(key)
    except av.error.FFmpegError:
        return  # as of an index that does not fit: the caller decodes from the beginning
    index, goal = wanted.start, order.stamps[wanted.start]
    for picture in pictures(clip, since=lambda: goal, strict=options.strict):
        if picture.pts is None or (index == wanted.start and picture.pts > goal):
            return  # the seek landed late: the caller decodes from the beginning
        if picture.pts < goal:
            continue
        check_picture(clip.name, picture, plan, index, options.limits)
        if index >= len(order.stamps) or picture.pts != order.stamps[index]:
            raise MediaError(f"{clip.name} is damaged after frame {index - 1}; upload it again")
        yield within_depth(clip.name, to_frame(picture, plan, index, picture.pts, clip.time_base))
        index += 1
        if index >= wanted.stop:
            return


def pictures(
    clip: OpenClip, since: Callable[[], int] | None = None, *, strict: bool = False
) -> Iterator[av.video.frame.VideoFrame]:
    """Decoded pictures in display order; MediaError names the frame where the data is damaged.

    since: a time stamp, asked for at each packet; pictures before it that no other picture needs are not decoded.
    strict: see `read_frames`.
    """
    count = packets = 0
    interlaced = begun = False
    context = clip.context
    try:
        if since is not None:
            context.open(strict=False)  # dav1d goes by what it is told then, and would never give what it was to skip
        for packet in clip.packets(strict=strict):
            if since is not None:
                early = packet.pts is not None and packet.pts < since()
                context.skip_frame = "NONREF" if early else "DEFAULT"
            packets += bool(packet.size and not packet.is_discard)
            for picture in clip.decode(packet):
                interlaced = interlaced or picture.interlaced_frame
                begun = begun or picture.key_frame  # at a cut between key pictures those before may lack others
                if begun and picture.is_corrupt:
                    raise MediaError(
                        f"{clip.name} is damaged after frame {count} (a part of a picture is missing); upload it again"
                    )
                yield picture
                count += 1
    except (av.error.FFmpegError, ValueError, MemoryError) as error:
        raise MediaError(f"{clip.name} is damaged after frame {count} ({reason(error)}); upload it again") from error
    # Decoders may skip what they cannot read without a word. A few are lost by design at a cut between key
    # pictures; the two fields of an interlaced picture may travel apart.
    if since is None and context.name in _ONE_FRAME_A_PACKET and not interlaced:
        _check_losses(clip.name, packets, count)


def _check_losses(name: str, packets: int, frames: int) -> None:
    if packets - frames > max(8, packets // 20):
        raise MediaError(f"{name} is damaged: only {frames} of its {packets} frames can be decoded; upload it again")


def _stamp(clip: OpenClip, picture: av.video.frame.VideoFrame, last: int | None) -> int:
    # a decoder gives a picture with the coding time of the packet that let it out: then it is shown
    pts = picture.dts if picture.pts is None or clip.stamps_are_of_coding else picture.pts
    if pts is None:
        rate = clip.stream.average_rate or Fraction(25)
        pts = 0 if last is None else last + max(1, round(1 / (rate * clip.time_base)))
    return pts if last is None or pts > last else last + 1


def check_picture(
    name: str, picture: av.video.frame.VideoFrame, plan: DecodingPlan, index: int, limits: MediaLimits
) -> None:
    """Raise MediaError for a picture of another size or layout than the clip's first one, or beyond a limit."""
    check_pixels(name, picture.width, picture.height, limits.max_pixels)
    if index >= limits.max_frames:
        most = limits.max_frames
        raise TooLongError(f"{name} has more than {most} frames; cut it shorter", most, "frames")
    size = (picture.width, picture.height)
    if size != plan.coded_size or picture.format.name != plan.coded_format:
        (width, height), was = size, plan.coded_size
        raise MediaError(
            f"{name} changes from {was[0]}x{was[1]} {plan.coded_format} to {width}x{height} "
            f"{picture.format.name} at frame {index}; re-encode it at one size"
        )


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
        picture = picture.reformat(format=("gbrap" if target.is_rgb else "yuva444p") + digits)
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
    if source.replace("yuva", "yuv").replace("gbrap", "gbrp") != target.name:
        full = RANGE_FULL if target.full_range else RANGE_LIMITED
        picture = picture.reformat(
            format=target.name,
            # the matrix is kept; swscale only moves samples, except into RGB where its input is RGB too
            src_color_range=full,
            dst_color_range=full,
            interpolation="BICUBIC",
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
