"""Frames out of a clip: upright, exact in time, streamed."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import av.error
import av.video.frame

from pvg.errors import MediaError, TooLongError
from pvg.video.decoding import DecodingPlan, decoding_plan, to_frame, within_depth
from pvg.video.display_order import DisplayOrder, display_order
from pvg.video.formats import Frame
from pvg.video.images import read_image
from pvg.video.opening import MediaLimits, OpenClip, open_clip, reason
from pvg.video.sniffing import IMAGE_KINDS, check_pixels, sniff
from pvg.video.stated import Stated

_NO_END = 1 << 62
_ONE_FRAME_A_PACKET = ("h264", "hevc", "mjpeg", "mpeg4", "prores", "png")


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
            _tell_change(clip.name, f"{change} at frame {index}", options)
            stated = None  # one is told
        check_picture(clip.name, picture, plan, index, options.limits)
        pts = _stamp(clip, picture, last)
        first = pts if first is None else first
        _check_duration(clip.name, (pts - first) * clip.time_base, index, options.limits)
        if index in wanted:
            yield within_depth(clip.name, to_frame(picture, plan, index, pts, clip.time_base))
        last, index = pts, index + 1
        if index >= wanted.stop:
            return
    if index == 0:
        raise MediaError(f"{clip.name} holds no frame that can be decoded; it is damaged or empty")


def _tell_change(name: str, change: str, options: _ReadOptions) -> None:
    """Of a clip that states otherwise what it is, from a frame on. Raises MediaError where that is refused."""
    if options.strict:
        raise MediaError(f"{name} {change}; re-encode it in one way")
    if options.notice is not None:
        options.notice(f"it {change}: all is read as its first picture")


def _check_duration(name: str, seconds: Fraction, index: int, limits: MediaLimits) -> None:
    if seconds > limits.max_duration_s:
        most_s = limits.max_duration_s
        raise TooLongError(f"{name} runs past {most_s} s at frame {index}; cut it shorter", most_s, "seconds")


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
            packets += clip.shows(packet)
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
