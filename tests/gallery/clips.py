"""Clips: small ones encoded on the spot, and parts of real ones."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from pvg.video import (
    Frame,
    MediaInfo,
    MediaLimits,
    PixelFormat,
    Plan,
    VideoWriter,
    make_plan,
    probe,
    read_frames,
    read_streams,
)
from pvg.video.formats import resolve_format
from tests.gallery.pictures import colorful

SIZE = (96, 64)


def pixel_format(name: str = "yuv420p", matrix: int = 1, color_range: int = 1) -> PixelFormat:
    return resolve_format(name, *SIZE, matrix, color_range)


def media_info(fmt: PixelFormat, size: tuple[int, int] = SIZE, **changes: Any) -> MediaInfo:
    facts: dict[str, Any] = {
        "kind": "video",
        "width": size[0],
        "height": size[1],
        "frame_rate": Fraction(25),
        "time_base": Fraction(1, 12800),
        "frame_count": 0,
        "duration_s": 0.0,
        "codec": "",
        "pixel_format": fmt.name,
        "color_matrix": 1,
        "color_range": 2 if fmt.full_range else 1,
        "color_primaries": 1,
        "color_transfer": 1,
        "rotation": 0,
        "has_audio": False,
        "audio_codec": None,
        "format": fmt,
    }
    return MediaInfo(**(facts | changes))


def noise_planes(fmt: PixelFormat, seed: int, size: tuple[int, int] = SIZE) -> Any:
    rng = np.random.default_rng(seed)
    return tuple(rng.integers(0, 2**fmt.depth, shape, dtype=fmt.dtype) for shape in fmt.plane_shapes(*size))


def smooth_frames(count: int, fmt: PixelFormat, size: tuple[int, int] = SIZE, step: int = 512) -> list[Frame]:
    base = colorful(1, size)
    return [Frame(k, k * step, k * step / 12800, fmt, fmt.from_rgb(np.roll(base, k, axis=1))) for k in range(count)]


def write_clip(path: Path, frames: Sequence[Frame], info: MediaInfo | None = None, **options: Any) -> Path:
    fmt = frames[0].format
    with VideoWriter(path, info or media_info(fmt, (frames[0].width, frames[0].height)), fmt, **options) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def rewrite_clip(source: Path, target: Path, plan: Plan | None = None) -> Path:
    """A clip written once more with all of its tracks, by a plan or as the target's container has it by default."""
    info = probe(source)
    plan = plan or make_plan(info, container=target.suffix, source=source, streams=read_streams(source))
    with VideoWriter(target, info, info.format, plan=plan, threads=1) as writer:
        for frame in read_frames(source):
            writer.write(frame)
    return target


def short_clip(path: Path, count: int = 20, **options: Any) -> Path:
    return write_clip(path, smooth_frames(count, pixel_format()), **options)


def cut_clip(source: Path, target: Path, start: int, stop: int) -> Path:
    """Write frames [start, stop) of a clip as a clip of its own."""
    info = probe(source)
    with VideoWriter(target, info, info.format, crf=12) as writer:
        for frame in read_frames(source, start=start, stop=stop):
            writer.write(frame)
    return target


def repeat_clip(source: Path, target: Path, times: int) -> Path:
    """Write the pictures of a clip so many times one after the other, as they are encoded."""
    with av.open(str(source)) as once, av.open(str(target), "w") as output:
        pictures = once.streams.video[0]
        copy = output.add_stream_from_template(pictures)
        assert pictures.duration is not None
        for number in range(times):
            once.seek(0)
            for packet in once.demux(pictures):
                if packet.pts is None or packet.dts is None:  # the last one, which is empty
                    continue
                packet.pts += number * pictures.duration
                packet.dts += number * pictures.duration
                packet.stream = copy
                output.mux_one(packet)
    return target


def libav_frame(rgb: np.ndarray, layout: str = "yuv420p") -> av.VideoFrame:
    """A picture as libav holds it in a layout."""
    return av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format=layout)


def encode_raw(
    path: Path,
    pictures: Sequence[av.VideoFrame],
    codec: str,
    *,
    rate: int | Fraction = 25,
    degrees: int = 0,
    hflip: bool = False,
    **options: str,
) -> Path:
    """A clip straight from libav, in whatever layout the codec takes."""
    with av.open(str(path), "w") as output:
        stream: Any = output.add_stream(codec, rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = pictures[0].width, pictures[0].height, pictures[0].format.name
        if degrees or hflip:
            stream.set_display_rotation(degrees, hflip=hflip)
        for k, item in enumerate(pictures):
            item.pts, item.time_base = k, 1 / Fraction(rate)
            output.mux(stream.encode(item))
        output.mux(stream.encode(None))
    return path


_FOLDERS = (b"moov", b"trak", b"edts", b"mdia", b"minf", b"stbl")


def change_boxes(path: Path, kind: bytes, change: Callable[[bytes], bytes]) -> Path:
    """Give the boxes of a kind another body, in an MP4 whose index stands last."""
    path.write_bytes(_changed_boxes(path.read_bytes(), kind, change))
    return path


def _changed_boxes(boxes: bytes, wanted: bytes, change: Callable[[bytes], bytes]) -> bytes:
    out, at = b"", 0
    while at < len(boxes):
        size, kind = struct.unpack_from(">I4s", boxes, at)
        body = boxes[at + 8 : at + size]
        if kind == wanted:
            body = change(body)
        elif kind in _FOLDERS:
            body = _changed_boxes(body, wanted, change)
        out += struct.pack(">I4s", len(body) + 8, kind) + body
        at += size
    return out


def color_container(path: Path, primaries: int, transfer: int, matrix: int) -> Path:
    """Have the container of an MP4 of pictures alone state their colours, of limited range; the pictures stay."""

    def colored(body: bytes) -> bytes:
        box = struct.pack(">I4s4sHHHB", 19, b"colr", b"nclx", primaries, transfer, matrix, 0)
        return body[:8] + struct.pack(">I", len(body) - 8 + len(box)) + body[12:] + box

    return change_boxes(path, b"stsd", colored)


def add_tone(path: Path, seconds: float, onset_s: float, target: Path) -> Path:
    """`path` with an AAC track: silence, then a 440 Hz tone from onset_s on."""
    rate = 48000
    time = np.arange(int(seconds * rate)) / rate
    wave = (np.sin(2 * np.pi * 440 * time) * (time >= onset_s) * 0.5).astype(np.float32)
    with av.open(str(path)) as source, av.open(str(target), "w") as output:
        video = output.add_stream_from_template(source.streams.video[0])
        audio: Any = output.add_stream("aac", rate=rate)
        audio.codec_context.layout = "mono"
        for start in range(0, len(wave), 1024):
            block = av.AudioFrame.from_ndarray(wave[None, start : start + 1024], format="fltp", layout="mono")
            block.sample_rate, block.pts, block.time_base = rate, start, Fraction(1, rate)
            output.mux(audio.encode(block))
        output.mux(audio.encode(None))
        for packet in source.demux(source.streams.video[0]):
            if packet.size:
                packet.stream = video
                output.mux_one(packet)
    return target


def every_frame(path: Path, limits: MediaLimits | None = None) -> int:
    """Read a clip or picture to its end; the number of its frames."""
    return sum(1 for _ in read_frames(path, limits=limits))


def sound_packets(path: Path) -> list[tuple[bytes, Fraction]]:
    """(bytes, time) of each sound packet."""
    with av.open(str(path)) as source:
        packets = source.demux(source.streams.audio[0])
        return [(bytes(packet), (packet.pts or 0) * packet.time_base) for packet in packets if packet.size]


def tone_onset(path: Path) -> float:
    """When the sound first gets loud, in seconds."""
    with av.open(str(path)) as source:
        for frame in source.decode(source.streams.audio[0]):
            loud = np.abs(frame.to_ndarray().astype(np.float64)).max(axis=0) > 0.1
            if loud.any():
                assert frame.time is not None
                return frame.time + int(loud.argmax()) / frame.sample_rate
    raise AssertionError("the track is silent")
