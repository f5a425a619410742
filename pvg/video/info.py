"""What a clip or picture is, known before it is worked on."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

from pvg.errors import MediaError
from pvg.video.formats import RANGE_FULL, UNSPECIFIED, PixelFormat
from pvg.video.images import read_image
from pvg.video.opening import MediaLimits, OpenClip, open_clip
from pvg.video.reading import packet_stamps, pictures, reading_of
from pvg.video.sniffing import IMAGE_KINDS, check_pixels, sniff


@dataclass(frozen=True)
class MediaInfo:
    """A clip or picture as its file describes it.

    width, height: upright, after rotation. frame_rate: on average, None for a picture. time_base: seconds a tick.
    frame_count: exact for pictures, else the container's claim or its count of packets. pixel_format: the libav
    name as coded. color_matrix, color_primaries, color_transfer: code points of ISO/IEC 23091-2 (2: not stated);
    color_range: 0 not stated, 1 limited, 2 full. rotation: degrees clockwise that make the stored picture
    upright. sample_aspect_ratio: width over height of an upright pixel. format: what `read_frames` delivers.
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


def probe(path: str | Path, limits: MediaLimits | None = None) -> MediaInfo:
    """Look at a clip or picture and hold it to the limits; one frame is decoded, after its size is checked.

    Raises MediaError in one line: not a clip or picture, damaged, only sound, or over a limit (with both numbers).
    """
    path = Path(path)
    limits = limits or MediaLimits()
    kind = sniff(path)
    if kind in IMAGE_KINDS:
        return _probe_image(path, kind, limits)
    with open_clip(path, limits) as clip:
        info = _probe_clip(clip, limits)
    if info.frame_count == 0 or info.frame_rate is None:
        info = _count_packets(path, info, limits)
    _check_totals(path.name, info, limits)
    return info


def _probe_image(path: Path, kind: str, limits: MediaLimits) -> MediaInfo:
    frame = read_image(path, limits)
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
    )


def _probe_clip(clip: OpenClip, limits: MediaLimits) -> MediaInfo:
    stream, context = clip.stream, clip.stream.codec_context
    check_pixels(clip.name, context.width, context.height, limits.max_pixels)
    rate = stream.average_rate or stream.guessed_rate
    length = float(stream.duration * clip.time_base) if stream.duration else 0.0
    length = length or (clip.container.duration or 0) / 1e6
    claims = MediaInfo(
        kind="video",
        width=context.width,
        height=context.height,
        frame_rate=rate or None,
        time_base=clip.time_base,
        frame_count=_claimed_frames(clip),
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
    reading = reading_of(clip, first)
    width, height = reading.upright_size
    aspect = stream.sample_aspect_ratio or Fraction(1)
    return replace(
        claims,
        width=width,
        height=height,
        pixel_format=first.format.name,
        rotation=reading.orientation.degrees,
        format=reading.target,
        sample_aspect_ratio=1 / aspect if reading.orientation.transpose else aspect,
    )


def _claimed_frames(clip: OpenClip) -> int:
    """The header's count, less the frames that its edit list leaves out; 0 when it does not say."""
    entries, claim = clip.stream.index_entries, clip.stream.frames
    if claim and len(entries) == claim:
        return sum(not entry.is_discard for entry in entries)
    return claim


def _audio_codec(clip: OpenClip) -> str | None:
    audio = clip.container.streams.audio
    if not audio:
        return None
    return audio[0].codec_context.name if audio[0].codec_context is not None else "unknown"


def _count_packets(path: Path, info: MediaInfo, limits: MediaLimits) -> MediaInfo:
    packets, time_base = packet_stamps(path, limits)
    stamps = [pts for pts, _ in packets if pts is not None]
    rate = info.frame_rate
    if rate is None and len(stamps) > 1 and max(stamps) > min(stamps):
        rate = (len(stamps) - 1) / ((max(stamps) - min(stamps)) * time_base)
    return replace(info, frame_count=len(packets), frame_rate=rate or Fraction(25))


def _check_totals(name: str, info: MediaInfo, limits: MediaLimits) -> None:
    if info.frame_count > limits.max_frames:
        raise MediaError(f"{name} has {info.frame_count} frames; at most {limits.max_frames} are accepted")
    if info.duration_s > limits.max_duration_s:
        raise MediaError(f"{name} lasts {info.duration_s:.1f} s; at most {limits.max_duration_s:.1f} s are accepted")
    if info.frame_rate is not None and info.frame_rate > limits.max_frame_rate:
        raise MediaError(
            f"{name} has {float(info.frame_rate):.2f} frames a second; at most {limits.max_frame_rate:g} are accepted"
        )


def sha256_file(path: str | Path) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
