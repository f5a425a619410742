"""What a clip or picture is, known before it is worked on."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

import av

from pvg.errors import MediaError, TooLargeError, TooLongError
from pvg.video.blocks import Blocks, read_blocks
from pvg.video.decoding import DecodingPlan, decoding_plan, has_alpha
from pvg.video.display_order import packet_stamps
from pvg.video.even_rate import even_rate_of
from pvg.video.formats import RANGE_FULL, UNSPECIFIED, UNSTATED, PixelFormat
from pvg.video.images import color_of_picture, read_image
from pvg.video.opening import MediaLimits, OpenClip, open_clip
from pvg.video.picture_metadata import read_picture_metadata
from pvg.video.reading import pictures
from pvg.video.sniffing import IMAGE_KINDS, check_pixels, claimed_bytes, cut_short, is_fragmented, sniff

_RATE_TOLERANCE = 1.01  # stamps are rounded, and the clocks of cameras run fast or slow
_HONEST = 0.9  # of a clip is within the length that its header says, at least
_UNKNOWN_FRAMES = 0x3FFFFFFF  # the least of what muxers write in an AVI's header when they do not know yet


@dataclass(frozen=True)
class MediaInfo:
    """A clip or picture as its file describes it.

    width, height: upright, after rotation. frame_rate: on average, None for a picture. time_base: seconds a tick.
    frame_count: exact for pictures, else the container's claim or its count of packets. pixel_format: the libav
    name as coded. color_matrix, color_primaries, color_transfer: code points of ISO/IEC 23091-2 (2: not stated);
    color_range: 0 not stated, 1 limited, 2 full. rotation: degrees clockwise that make the stored picture
    upright. sample_aspect_ratio: width over height of an upright pixel. format: what `read_frames` delivers.
    has_alpha: whether its frames come with an alpha plane. even_rate: that of frames whose time stamps the container
    has rounded to its steps; None where they are exact, or the rate is variable.
    warnings: what of the file is not read, a line each: an end that is missing, further picture streams.
    """

    kind: Literal["video", "image"]
    width: int
    height: int
    frame_rate: Fraction | None
    time_base: Fraction | None
    frame_count: int
    duration_s: float
    codec: str
    pixel_format: str
    color_matrix: int
    color_range: int
    color_primaries: int
    color_transfer: int
    rotation: int
    has_audio: bool
    audio_codec: str | None
    format: PixelFormat
    sample_aspect_ratio: Fraction = Fraction(1)
    has_alpha: bool = False
    even_rate: Fraction | None = None
    warnings: tuple[str, ...] = ()

    @property
    def color(self) -> str:
        """How its colours are read, for people: "SDR", "PQ BT.2020", "S-Log3", …"""
        return "SDR" if self.format.color is None else self.format.color.name


def probe(
    path: str | Path, limits: MediaLimits | None = None, *, input_color: str = "auto", strict: bool = False
) -> MediaInfo:
    """Look at a clip or picture and hold it to the limits; one frame is decoded, after its size is checked.

    input_color: one of `color.INPUT_COLORS`, for clips whose tags do not say how they are coded;
    strict: a clip whose end is cut off is refused; else its frames are counted up to there, and a warning says so.
    Raises MediaError in one line: not a clip or picture, damaged, only sound, or over a limit (with both numbers):
    TooLongError, TooLargeError.
    """
    path = Path(path)
    limits = limits or MediaLimits()
    kind = sniff(path)
    if kind in IMAGE_KINDS:
        return _probe_image(path, kind, limits, input_color)
    with open_clip(path, limits) as clip:
        info = _probe_clip(clip, limits, input_color)
        claimed, size = max(claimed_bytes(path, kind), _last_sample(clip)), path.stat().st_size
        if is_fragmented(path, kind):
            hidden_s = float(-min(0, clip.stream.start_time or 0) * clip.time_base)
            info = replace(info, frame_count=0, duration_s=max(0.0, info.duration_s - hidden_s))
        elif _is_over_before_shown(clip, info.duration_s):
            info = replace(info, duration_s=0.0)
    blocks = read_blocks(path) if kind == "matroska" else Blocks(size)
    if blocks.gap is not None:
        raise MediaError(f"{path.name} is damaged at byte {blocks.gap}: pictures may be missing; upload it again")
    if claimed > size:
        if strict:
            raise cut_short(path.name, claimed, size)
        info = _of_cut_file(path, info, limits, f"{size / claimed:.0%} of its bytes are there")
    elif blocks.end > size:  # recorded live: how long it was is not known
        if strict:
            raise MediaError(f"{path.name} is cut short: its last block is damaged or not whole; upload it whole")
        info = _of_cut_file(path, info, limits, "its last block is damaged or not whole")
    if info.frame_count == 0 or info.frame_rate is None or info.duration_s == 0.0:
        info = _count_packets(path, info, limits)
    _check_totals(path.name, info, limits)
    return info


def _probe_image(path: Path, kind: str, limits: MediaLimits, input_color: str) -> MediaInfo:
    frame = read_image(path, limits, input_color)
    unread = color_of_picture(read_picture_metadata(path))[1] if input_color == "auto" else None
    return MediaInfo(
        kind="image",
        width=frame.width,
        height=frame.height,
        frame_rate=None,
        time_base=None,
        frame_count=1,
        duration_s=0.0,
        codec=kind,
        pixel_format=frame.format.name,
        color_matrix=0,
        color_range=RANGE_FULL,
        color_primaries=UNSPECIFIED,
        color_transfer=UNSPECIFIED,
        rotation=0,
        has_audio=False,
        audio_codec=None,
        format=frame.format,
        has_alpha=frame.alpha is not None,
        warnings=() if unread is None else (unread,),
    )


def _probe_clip(clip: OpenClip, limits: MediaLimits, input_color: str) -> MediaInfo:
    stream, context = clip.stream, clip.stream.codec_context
    check_pixels(clip.name, context.width, context.height, limits.max_pixels)
    rate = stream.average_rate  # what libav guesses else is the grid of the time stamps
    count, length = _claims(clip)
    claims = MediaInfo(
        kind="video",
        width=context.width,
        height=context.height,
        frame_rate=rate or None,
        time_base=clip.time_base,
        frame_count=count,
        duration_s=length,
        codec=context.name,
        pixel_format=context.pix_fmt or "",
        color_matrix=context.colorspace,
        color_range=context.color_range,
        color_primaries=context.color_primaries,
        color_transfer=context.color_trc,
        rotation=0,
        has_audio=bool(clip.container.streams.audio),
        audio_codec=_audio_codec(clip),
        format=PixelFormat("", 8, (1, 1), None, False),
    )
    _check_totals(clip.name, claims, limits)
    first = next(pictures(clip), None)
    if first is None:
        raise MediaError(f"{clip.name} holds no frame that can be decoded; it is damaged or empty")
    check_pixels(clip.name, first.width, first.height, limits.max_pixels)
    decoding = decoding_plan(clip, first, input_color)
    width, height = decoding.upright_size
    aspect = stream.sample_aspect_ratio or Fraction(1)
    matrix = claims.color_matrix
    return replace(
        claims,
        width=width,
        height=height,
        pixel_format=first.format.name,
        color_matrix=decoding.matrix if matrix in UNSTATED and not decoding.target.is_rgb else matrix,
        rotation=decoding.orientation.degrees,
        format=decoding.target,
        sample_aspect_ratio=1 / aspect if decoding.orientation.transpose else aspect,
        has_alpha=has_alpha(first),
        warnings=_of_streams(clip) + _of_turn(decoding) + (_of_colors(clip, decoding) if input_color == "auto" else ()),
    )


# what makers of cameras and editing suites write into tags -> what `input_color` calls it
_LOGARITHMS = {
    re.compile(r"\bs-?log-?3\b", re.IGNORECASE): "slog3",
    re.compile(r"\blog-?c-?4\b", re.IGNORECASE): "logc4",
    re.compile(r"\blog-?c(-?3)?\b", re.IGNORECASE): "logc3",
    re.compile(r"\bv-?log\b", re.IGNORECASE): "vlog",
    re.compile(r"\bapple-? ?log\b", re.IGNORECASE): "applelog",
}


def _of_colors(clip: OpenClip, decoding: DecodingPlan) -> tuple[str, ...]:
    """What is to be known of a clip whose colours were read by its tags."""
    told = " ".join([*clip.container.metadata.values(), *clip.stream.metadata.values()])
    named = next((name for pattern, name in _LOGARITHMS.items() if pattern.search(told)), None)
    if named is not None:
        return (f"its tags speak of a camera's logarithm, which is not guessed: name it as the input color, {named}",)
    transfers = {clip.stream.codec_context.color_trc, clip.colors.transfer}
    unstated = transfers <= {0, UNSPECIFIED}
    if unstated and decoding.target.color is None and decoding.target.depth > 8:
        return ("it does not say its transfer function and is read as SDR: if it is not, name the input color",)
    return ()


def _of_streams(clip: OpenClip) -> tuple[str, ...]:
    if clip.choices == 1:
        return ()
    number = [stream.index for stream in clip.container.streams.video].index(clip.stream.index) + 1
    return (
        f"the file has {clip.choices} video streams: number {number} is used, the first marked default, or else the "
        "first; the others are not kept",
    )


def _of_turn(decoding: DecodingPlan) -> tuple[str, ...]:
    turn = decoding.orientation
    if not turn.is_rounded:
        return ()
    return (f"it asks to be turned by {turn.asked:.1f} degrees and is turned by {turn.degrees}: by quarters alone",)


def _last_sample(clip: OpenClip) -> int:
    """Where the last sample of an MP4's picture stream ends by its index; 0 for other containers."""
    if not clip.is_mp4:
        return 0
    return max((entry.pos + entry.size for entry in clip.stream.index_entries), default=0)


def _of_cut_file(path: Path, info: MediaInfo, limits: MediaLimits, why: str) -> MediaInfo:
    """What is left of a clip whose end is missing; why: what tells that, in words."""
    counted, seconds = _counted_packets(path, info, limits)
    of = f" of {info.frame_count}" if info.frame_count > counted.frame_count else ""
    line = f"the file is cut short: {why}"
    line += f"; its first {counted.frame_count}{of} frames are read"
    return replace(counted, duration_s=min(counted.duration_s or seconds, seconds), warnings=(*info.warnings, line))


def _claims(clip: OpenClip) -> tuple[int, float]:
    """The header's frames, less those that its edit list leaves out, and its seconds; 0 for what it does not say.

    Nor does it say how long the clip is where that would be over before the last frame begins.
    """
    stream, entries, frames = clip.stream, clip.stream.index_entries, clip.stream.frames
    if frames and clip.container.format.name == "avi" and frames >= min(_UNKNOWN_FRAMES, clip.container.size):
        return 0, 0.0  # never finished, or written to a pipe; libav guesses the length from the claim
    begun = [entry.timestamp for entry in entries if not entry.is_discard]
    # that of MP4 has what several edits show of one frame as several
    if frames and entries and (clip.is_mp4 or len(entries) == frames):
        frames = len(begun)
    length = float(stream.duration * clip.time_base) if stream.duration else 0.0
    if begun and _is_over_before((max(begun) - min(begun)) * clip.time_base, len(begun) - 1, length):
        return frames, 0.0
    if "matroska" in clip.container.format.name and (clip.container.start_time or 0) > 0:
        return frames, 0.0  # some writers count in what lies before the first packet, others do not
    return frames, length or (clip.container.duration or 0) / 1e6


def _is_over_before(span: Fraction, steps: int, length: float) -> bool:
    """Whether a clip of this length, seconds, is over long before its last frame begins.

    span: seconds from the first frame to the last, in so many steps. Headers of honest files are off by a frame, and an
    index has the frames in the order in which they are decoded, which begins earlier than they are shown.
    """
    return steps > 0 and length + span / steps < _HONEST * span


def _is_over_before_shown(clip: OpenClip, length: float) -> bool:
    """Whether an MP4 of this length is over long before its last frame is shown, by the packets from its last key on.

    Its index does not tell: where frames are reordered, one that is shown late is decoded soon after those before it,
    and muxers write a length that goes by that. Afterwards the clip is at its end.
    """
    stream = clip.stream
    kept = [entry for entry in stream.index_entries if not entry.is_discard]
    keys = [entry.timestamp for entry in kept if entry.is_keyframe]
    if not (length and keys and stream.codec_context.has_b_frames and clip.is_mp4):
        return False
    try:
        clip.container.seek(max(keys), stream=stream)
        packets = clip.container.demux(stream)
        last = max((one.pts for one in packets if one.pts is not None and not one.is_discard), default=None)
    except av.error.FFmpegError:  # it is damaged, which is found by who reads all of it
        return False
    if last is None:
        return False
    return _is_over_before((last - (stream.start_time or 0)) * clip.time_base, len(kept) - 1, length)


def _audio_codec(clip: OpenClip) -> str | None:
    audio = clip.container.streams.audio
    if not audio:
        return None
    return audio[0].codec_context.name if audio[0].codec_context is not None else "unknown"


def _count_packets(path: Path, info: MediaInfo, limits: MediaLimits) -> MediaInfo:
    """The clip by its packets; it lasts as long as its header says, if that says so and is not over before."""
    counted, seconds = _counted_packets(path, info, limits)
    return replace(counted, duration_s=counted.duration_s or seconds)


def _counted_packets(path: Path, info: MediaInfo, limits: MediaLimits) -> tuple[MediaInfo, float]:
    """The clip with its frames and their rate by its packets, and the seconds from its first frame to its end.

    Its own `duration_s` is what the header says: the last frame may stand for long, and sound last longer. It is 0
    where that would be over long before the last frame begins.
    """
    packets, time_base = packet_stamps(path, limits)
    stamps = [pts for pts, _ in packets if pts is not None]
    span, steps = (max(stamps, default=0) - min(stamps, default=0)) * time_base, len(stamps) - 1
    if _is_over_before(span, steps, info.duration_s):
        info = replace(info, duration_s=0.0)
    rate, is_whole = info.frame_rate, len(stamps) == len(packets)
    even = even_rate_of(sorted(stamps), time_base, rate) if rate is not None and is_whole else None
    # with no length stated, a rate that leaves the stamps by more than a frame is not that of the whole clip
    if span and (rate is None or (not info.duration_s and abs(span * rate - steps) > 1)):
        rate = steps / span
        # frames that are left out lower it, and leave the others where they are
        even = even or (even_rate_of(sorted(stamps), time_base, rate) if is_whole else None)
    rate = rate or Fraction(25)
    length = span + 1 / rate if is_whole else len(packets) / rate
    return replace(info, frame_count=len(packets), frame_rate=rate, even_rate=even), float(length)


def _check_totals(name: str, info: MediaInfo, limits: MediaLimits) -> None:
    if info.frame_count > limits.max_frames:
        message = f"{name} has {info.frame_count} frames; at most {limits.max_frames} are accepted"
        raise TooLongError(message, limits.max_frames, "frames")
    if info.duration_s > limits.max_duration_s:
        message = f"{name} lasts {info.duration_s:.1f} s; at most {limits.max_duration_s:.1f} s are accepted"
        raise TooLongError(message, limits.max_duration_s, "seconds")
    if info.frame_rate is not None and info.frame_rate > _RATE_TOLERANCE * limits.max_frame_rate:
        rate = float(info.frame_rate)
        message = f"{name} has {rate:.2f} frames a second; at most {limits.max_frame_rate:g} are accepted"
        raise TooLargeError(message, limits.max_frame_rate, "frames per second")
