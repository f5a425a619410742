"""Clips that are odd in one way each: made with libav on the spot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.codec.context
import av.stream
import cv2
import numpy as np

from tests.gallery.clips import encode_raw, libav_frame
from tests.gallery.pictures import colorful

TICK = Fraction(1, 1000)
FRAMES = 24
_STEP = 40


def _pictures(count: int = FRAMES, size: tuple[int, int] = (96, 64)) -> list[av.VideoFrame]:
    base = colorful(7, size)
    return [libav_frame(np.roll(base, 3 * k, 1)) for k in range(count)]


def _packets(
    pictures: Sequence[av.VideoFrame], stamps: Sequence[int] | None = None, *, matrix: int = 2, interlaced: bool = False
) -> list[Any]:
    """H.264 packets, in ticks, whose key pictures carry their own headers."""
    context: Any = av.CodecContext.create("libx264", "w")
    context.width, context.height, context.pix_fmt = pictures[0].width, pictures[0].height, pictures[0].format.name
    context.time_base, context.framerate, context.options = TICK, Fraction(25), {"g": "8", "bf": "2"}
    context.colorspace = matrix
    if interlaced:
        context.flags |= av.codec.context.Flags.interlaced_dct
        context.options = {**context.options, "x264-params": "tff=1"}
    out = []
    for k, picture in enumerate(pictures):
        picture.pts, picture.time_base = (stamps[k] if stamps else k * _STEP), TICK
        picture.colorspace = matrix
        out += context.encode(picture)
    return [*out, *context.encode(None)]


def _encode(path: Path, stamps: Sequence[int] = range(0, FRAMES * _STEP, _STEP), **options: str) -> Path:
    with av.open(str(path), "w", options={"avoid_negative_ts": "disabled", **options}) as output:
        stream: Any = output.add_stream("libx264", rate=25, options={"g": "8", "bf": "2"})
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        stream.time_base = stream.codec_context.time_base = TICK
        for picture, stamp in zip(_pictures(len(stamps)), stamps, strict=True):
            picture.pts, picture.time_base = stamp, TICK
            output.mux(stream.encode(picture))
        output.mux(stream.encode(None))
    return path


def _copied(source: Path, target: Path, change: Callable[[Any], bool] = lambda packet: True, **options: str) -> Path:
    """The same packets in another container; `change` may alter one, or drop it by answering False."""
    with av.open(str(source)) as given, av.open(str(target), "w", options=options) as output:
        stream = output.add_stream_from_template(given.streams.video[0])
        for packet in given.demux(given.streams.video[0]):
            if packet.size and change(packet):
                packet.stream = stream
                output.mux_one(packet)
    return target


def edit_list(folder: Path) -> Path:
    """An MP4 whose edit list leaves out the first 6 of 24 frames: media time of the first edit is moved on."""
    path = _encode(folder / "edit_list.mp4")
    data = bytearray(path.read_bytes())
    at = data.index(b"elst") + 4
    entries = int.from_bytes(data[at + 4 : at + 8], "big")
    assert entries == 1, "one edit is expected"
    media_time = int.from_bytes(data[at + 12 : at + 16], "big")
    timescale_at = data.index(b"mdhd") + 4 + 12
    scale = int.from_bytes(data[timescale_at : timescale_at + 4], "big")
    data[at + 12 : at + 16] = (media_time + 6 * _STEP * scale // 1000).to_bytes(4, "big")
    duration = int.from_bytes(data[at + 8 : at + 12], "big")
    data[at + 8 : at + 12] = (duration * 18 // 24).to_bytes(4, "big")
    return _filled(path, data)


def edit_list_of_fragments(folder: Path) -> Path:
    """A fragmented MP4 whose edit list leaves out the first 6 of 24 frames: its fragments begin before zero."""
    stamps = range(-6 * _STEP, (FRAMES - 6) * _STEP, _STEP)
    return _encode(folder / "edit_list_f.mp4", stamps, movflags="frag_keyframe+delay_moov")


def negative_start(folder: Path) -> Path:
    """An MP4 without edit list whose pictures begin before zero."""
    return _encode(folder / "negative_start.mp4", range(-200, FRAMES * _STEP - 200, _STEP), use_editlist="0")


def negative_start_mkv(folder: Path) -> Path:
    """A Matroska file whose first block is stamped 80 ms before its cluster, which is at zero."""
    path = _encode(folder / "negative_start.mkv")
    data = bytearray(path.read_bytes())
    at = data.index(b"\x1f\x43\xb6\x75")  # the first cluster
    block = data.index(b"\xa3", at + 8)  # a SimpleBlock: size, track 1, time, flags
    track = data.index(b"\x81\x00\x00\x80", block, block + 16)
    data[track + 1 : track + 3] = (-80).to_bytes(2, "big", signed=True)
    return _filled(path, data)


def late_start(folder: Path) -> Path:
    """An MP4 whose first picture is shown after 3 s: an empty edit."""
    return _encode(folder / "late_start.mp4", range(3000, 3000 + FRAMES * _STEP, _STEP))


def late_start_mkv(folder: Path) -> Path:
    """A Matroska file whose first picture is shown after 3 s."""
    return _encode(folder / "late_start.mkv", range(3000, 3000 + FRAMES * _STEP, _STEP))


def variable_rate(folder: Path) -> Path:
    """Frames 20 to 300 ms apart."""
    steps = np.random.default_rng(5).integers(20, 300, FRAMES)
    return _encode(folder / "variable_rate.mp4", np.cumsum(steps).tolist())


def missing_durations(folder: Path) -> Path:
    """A live WebM: no duration, no count, no index, unknown segment length."""
    plain = folder / "plain.webm"
    encode_raw(plain, _pictures(), "libvpx-vp9", **{"deadline": "realtime", "cpu-used": "8"})

    def without(packet: Any) -> bool:
        packet.duration = 0
        return True

    return _copied(plain, folder / "missing_durations.webm", without, live="1")


def raw_stamps_missing(folder: Path) -> Path:
    """An AVI: time stamps of coding alone."""
    return encode_raw(folder / "no_display_stamps.avi", _pictures(), "mpeg4", g="8", bf="0")


def changed_resolution(folder: Path) -> Path:
    """12 frames of 96x64 and then 12 of 128x80, in one Matroska track whose key pictures carry their own headers."""
    before = _packets(_pictures(12))
    after = _packets(_pictures(12, (128, 80)), stamps=range(12 * _STEP, 24 * _STEP, _STEP))
    return _joined(folder / "changed_resolution.mkv", before, after)


def changed_tags(folder: Path) -> Path:
    """12 frames of BT.709 and then 12 of BT.601."""
    before = _packets(_pictures(12), matrix=1)
    after = _packets(_pictures(12), stamps=range(12 * _STEP, 24 * _STEP, _STEP), matrix=6)
    return _joined(folder / "changed_tags.mkv", before, after)


def changed_fields(folder: Path) -> Path:
    """12 progressive frames and then 12 interlaced ones."""
    before = _packets(_pictures(12))
    after = _packets(_pictures(12), stamps=range(12 * _STEP, 24 * _STEP, _STEP), interlaced=True)
    return _joined(folder / "changed_fields.mkv", before, after)


def _joined(path: Path, before: list[Any], after: list[Any]) -> Path:
    with av.open(str(path), "w") as output:
        stream: Any = output.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        stream.time_base = TICK
        for packet in [*before, *after]:
            packet.stream = stream
            output.mux_one(packet)
    return path


def attached_picture(folder: Path) -> Path:
    """An MP4 with a JPEG as its cover, which is a track as well."""
    plain = _encode(folder / "plain_cover.mp4")
    path = folder / "attached_picture.mp4"
    done, cover = cv2.imencode(".jpg", colorful(3, (300, 300)))
    assert done
    with av.open(str(plain)) as given, av.open(str(path), "w") as output:
        art: Any = output.add_stream("mjpeg", rate=25)
        art.width, art.height, art.pix_fmt = 300, 300, "yuvj420p"
        art.disposition = av.stream.Disposition.attached_pic
        stream = output.add_stream_from_template(given.streams.video[0])
        packet = av.Packet(cover.tobytes())
        packet.stream, packet.pts, packet.dts, packet.time_base = art, 0, 0, TICK
        output.mux_one(packet)
        for item in given.demux(given.streams.video[0]):
            if item.size:
                item.stream = stream
                output.mux_one(item)
    return path


def two_videos(folder: Path) -> Path:
    """A Matroska file of two picture tracks, 128x80 and 96x64, the second marked default."""
    path = folder / "two_videos.mkv"
    sizes = ((128, 80), (96, 64))
    with av.open(str(path), "w") as output:
        streams = []
        for size in sizes:
            stream: Any = output.add_stream("libx264", rate=25)
            stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
            streams.append(stream)
        streams[0].disposition = av.stream.Disposition(0)
        streams[1].disposition = av.stream.Disposition.default
        for k, pictures in enumerate(zip(*(_pictures(FRAMES, size) for size in sizes), strict=True)):
            for stream, picture in zip(streams, pictures, strict=True):
                picture.pts, picture.time_base = k, Fraction(1, 25)
                output.mux(stream.encode(picture))
        for stream in streams:
            output.mux(stream.encode(None))
    return path


def _cut(path: Path, name: str, packet: int) -> Path:
    """The file up to the middle of that packet of it, however many bytes the encoder wrote before."""
    start, size = _place(path, packet)
    return _filled(path.with_name(name), path.read_bytes()[: start + size // 2])


def _place(path: Path, packet: int) -> tuple[int, int]:
    """Where that packet of a clip is in its file, and how many bytes it has."""
    with av.open(str(path)) as clip:
        found: Any = [one for one in clip.demux(clip.streams.video[0]) if one.size][packet]
    return found.pos, found.size


def _filled(path: Path, data: bytes | bytearray) -> Path:
    path.write_bytes(data)
    return path


def cut_mp4(folder: Path) -> Path:
    """Its index stands first, the last fifth of the file is missing."""
    whole = _encode(folder / "whole.mp4", movflags="faststart")
    return _cut(whole, "cut.mp4", 16)


def cut_variable_rate(folder: Path) -> Path:
    """The same of a clip whose frames are 300 ms apart at first, then 20 ms."""
    steps = np.where(np.arange(FRAMES) < FRAMES // 2, 300, 20)
    whole = _encode(folder / "whole_v.mp4", np.cumsum(steps).tolist(), movflags="faststart")
    return _cut(whole, "cut_v.mp4", 16)


def cut_fragments(folder: Path) -> Path:
    """A fragmented MP4, cut inside a fragment."""
    flags = "frag_keyframe+empty_moov+default_base_moof"
    return _cut(_encode(folder / "whole_f.mp4", movflags=flags), "cut_f.mp4", 11)


def cut_mkv(folder: Path) -> Path:
    """A Matroska file without its last fifth."""
    return _cut(_encode(folder / "whole.mkv"), "cut.mkv", 16)


def cut_live_mkv(folder: Path) -> Path:
    """The same as a live recording, which says neither its own length nor that of its clusters."""
    return _cut(_encode(folder / "whole_live.mkv", live="1"), "cut_live.mkv", 16)


def cut_avi(folder: Path) -> Path:
    """An AVI without its last tenth."""
    return _cut(raw_stamps_missing(folder), "cut.avi", 16)


def damaged_middle(folder: Path) -> Path:
    """An MP4 of 200 frames of which a fifth is overwritten, behind the middle."""
    path = _encode(folder / "damaged.mp4", range(0, 200 * _STEP, _STEP), movflags="faststart")
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 4
    low, high = (start + (len(data) - start) * tenths // 10 for tenths in (6, 8))
    data[low:high] = b"\xff" * (high - low)
    return _filled(path, data)


def damaged_picture(folder: Path) -> Path:
    """An MP4 of 24 frames with the middle of one's bytes overwritten, which its decoder goes on after."""
    path = _encode(folder / "damaged_picture.mp4")
    start, size = _place(path, 8)
    data, middle = bytearray(path.read_bytes()), start + size // 2
    data[middle : middle + 200] = np.random.default_rng(1).bytes(200)
    return _filled(path, data)


def lost_blocks(folder: Path) -> Path:
    """A Matroska file of 24 frames, a block's head in the middle overwritten: readers go on at the next cluster."""
    path = _encode(folder / "lost_blocks.mkv", cluster_time_limit="400")
    start, _ = _place(path, 10)
    data = bytearray(path.read_bytes())
    data[start - 2 : start + 10] = bytes(12)
    return _filled(path, data)


def open_group(folder: Path) -> Path:
    """An MP4 of 24 frames cut between key pictures, so that the first ones lean on others that are gone."""
    path = folder / "open_group_whole.mp4"
    encode_raw(path, _pictures(), "libx264", **{"bf": "2", "x264-params": "keyint=8:open-gop=1:scenecut=0"})
    keys: list[bool] = []

    def later(packet: Any) -> bool:
        keys.append(packet.is_keyframe)
        return sum(keys) > 1

    return _copied(path, folder / "open_group.mp4", later)


MADE: dict[str, Callable[[Path], Path]] = {
    "edit list": edit_list,
    "edit list of fragments": edit_list_of_fragments,
    "negative start": negative_start,
    "negative start, mkv": negative_start_mkv,
    "late start, mp4": late_start,
    "late start, mkv": late_start_mkv,
    "variable rate": variable_rate,
    "missing durations": missing_durations,
    "no display stamps": raw_stamps_missing,
    "changed resolution": changed_resolution,
    "attached picture": attached_picture,
    "two videos": two_videos,
    "cut mp4": cut_mp4,
    "cut variable rate": cut_variable_rate,
    "cut fragments": cut_fragments,
    "cut mkv": cut_mkv,
    "cut live mkv": cut_live_mkv,
    "cut avi": cut_avi,
    "damaged middle": damaged_middle,
    "damaged picture": damaged_picture,
}
"""Every odd clip by what is odd about it."""
