from __future__ import annotations

import errno
import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.errors import MediaError, PartError
from pvg.video import Frame, MediaInfo, Plan, VideoWriter, can_join, join, make_plan, probe, read_frames, read_streams
from pvg.video.encoding import PictureEncoder
from pvg.video.parts import ClipOfParts, PartReader, PartWriter
from tests.gallery.clips import media_info, pixel_format, smooth_frames, sound_packets
from tests.gallery.rich_clips import Other, Rich

_SIZE = (288, 160)
_BOUNDS = (0, 9, 20, 34)
_MADE_BY = "a version"
_SHA = "0" * 64
WAYS = [
    *(("mp4", codec, "yuv420p") for codec in ("h264", "hevc", "vp9", "av1")),
    ("mp4", "hevc", "yuv420p10le"),
    ("mov", "h264", "yuv422p"),
    ("mov", "prores", "yuv422p10le"),
    ("mov", "prores4444", "yuv444p10le"),
    ("mov", "dnxhr", "yuv422p"),
    ("mkv", "ffv1", "yuv420p"),
    ("mkv", "hevc", "yuv422p10le"),
    ("webm", "av1", "yuv420p"),
    ("webm", "vp9", "yuv420p"),
]


def _frames(layout: str, count: int = _BOUNDS[-1], *, even: bool = False) -> list[Frame]:
    """Frames with uneven steps and a late start, in whole milliseconds for Matroska."""
    frames = smooth_frames(count, pixel_format(layout), _SIZE)
    steps = np.full(count, 40) if even else np.random.default_rng(4).integers(11, 190, count)
    return [
        replace(frame, pts=int(pts) * 90, duration=int(step) * 90)
        for frame, pts, step in zip(frames, np.cumsum(steps), steps, strict=True)
    ]


def _info(layout: str) -> MediaInfo:
    return media_info(pixel_format(layout), _SIZE, time_base=Fraction(1, 90000))


def _write_parts(
    folder: Path, frames: Sequence[Frame], info: MediaInfo, plan: Plan, bounds: Sequence[int] = _BOUNDS, **options: Any
) -> list[Path]:
    paths = []
    for start, stop in pairwise(bounds):
        encoder = PictureEncoder(info, info.format, plan, part=True, **options)
        path = folder / f"{start}.part"
        clip = ClipOfParts(_SHA, bounds[-1], options.get("crf"), options.get("preset"), _MADE_BY)
        with PartWriter(path, encoder, clip, start=start, stop=stop) as writer:
            for frame in frames[start:stop]:
                writer.write(frame)
        paths.append(path)
    return paths


def _join(
    parts: Sequence[Path], path: Path, info: MediaInfo, plan: Plan, count: int = _BOUNDS[-1], **facts: Any
) -> Path:
    join(parts, path, info, plan, replace(ClipOfParts(_SHA, count, None, None, _MADE_BY), **facts))
    return path


def _whole(path: Path, frames: Sequence[Frame], info: MediaInfo, plan: Plan, **options: Any) -> Path:
    with VideoWriter(path, info, info.format, plan=plan, threads=1, **options) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def _packets(path: Path) -> list[tuple[int | None, int | None, int | None]]:
    with av.open(str(path)) as opened:
        packets = opened.demux(opened.streams.video[0])
        return [(packet.pts, packet.dts, packet.duration) for packet in packets if packet.size]


def _stream(path: Path) -> tuple[Any, ...]:
    """What a file says of its pictures."""
    with av.open(str(path)) as opened:
        stream, context = opened.streams.video[0], opened.streams.video[0].codec_context
        said = (context.extradata, context.codec_tag, context.pix_fmt, context.width, context.height)
        colors = (context.colorspace, context.color_primaries, context.color_trc, context.color_range)
        return (*said, *colors, stream.time_base, stream.average_rate, stream.duration, stream.sample_aspect_ratio)


def _pixels(path: Path) -> list[bytes]:
    return [b"".join(plane.tobytes() for plane in frame.planes) for frame in read_frames(path)]


@pytest.mark.parametrize("codec", ["h264", "hevc"])
def test_parts_of_an_even_rate_that_a_container_rounded_have_its_times(codec: str, tmp_path: Path) -> None:
    rate = Fraction(24000, 1001)
    info = replace(_info("yuv420p"), time_base=Fraction(1, 1000), frame_rate=rate, even_rate=rate)
    stamps = [round(k * 1000 / rate) for k in range(_BOUNDS[-1] + 1)]
    frames = [
        replace(frame, pts=start, duration=end - start)
        for frame, (start, end) in zip(_frames("yuv420p"), pairwise(stamps), strict=True)
    ]
    plan = make_plan(info, container="mp4", codec=codec)
    joined = _join(_write_parts(tmp_path, frames, info, plan), tmp_path / "joined.mp4", info, plan)
    whole = _whole(tmp_path / "whole.mp4", frames, info, plan)
    shown = [sorted(pts for pts, _, _ in _packets(path) if pts is not None) for path in (joined, whole)]
    assert shown[0] == shown[1]
    assert {later - start for start, later in pairwise(shown[0])} == {1001}
    assert probe(joined).duration_s == probe(whole).duration_s


@pytest.mark.parametrize(("container", "codec", "layout"), WAYS)
def test_a_joined_clip_has_the_stamps_and_the_head_of_one_encoded_whole(
    container: str, codec: str, layout: str, tmp_path: Path
) -> None:
    assert can_join(container, codec)
    frames, info = _frames(layout), _info(layout)
    plan = make_plan(info, container=container, codec=codec)
    whole = _whole(tmp_path / f"whole.{container}", frames, info, plan)
    joined = _join(_write_parts(tmp_path, frames, info, plan), tmp_path / f"joined.{container}", info, plan)
    if codec in ("prores", "prores4444", "dnxhr"):
        assert joined.read_bytes() == whole.read_bytes()  # every picture is coded alone
    assert _shown(joined) == _shown(whole)
    assert [dts for _, dts, _ in _packets(joined)] == [dts for _, dts, _ in _packets(whole)]
    # x265 says of its threads in the head
    assert _stream(joined)[codec == "hevc" :] == _stream(whole)[codec == "hevc" :]
    # the pictures of each part are those that it gives alone
    seen = _pixels(joined)
    assert len(seen) == len(frames)
    for start, stop in pairwise(_BOUNDS):
        bounds = (0, stop - start)
        (tmp_path / f"{start}").mkdir()
        moved = [replace(frame, index=k) for k, frame in enumerate(frames[start:stop])]
        alone = _write_parts(tmp_path / f"{start}", moved, info, plan, bounds)
        assert (
            _pixels(_join(alone, tmp_path / f"{start}" / f"one.{container}", info, plan, bounds[-1]))
            == seen[start:stop]
        )


def _shown(path: Path) -> list[int]:
    return sorted(pts for pts, _, _ in _packets(path) if pts is not None)


@pytest.mark.parametrize("codec", ["h264", "hevc"])
def test_an_even_frame_rate_stays_even_in_decode_stamps(codec: str, tmp_path: Path) -> None:
    frames, info = _frames("yuv420p", even=True), _info("yuv420p")
    plan = make_plan(info, container="mp4", codec=codec)
    joined = _join(
        _write_parts(tmp_path, frames, info, plan, preset="slow"), tmp_path / "a.mp4", info, plan, preset="slow"
    )
    packets = _packets(joined)
    assert {later[1] - packet[1] for packet, later in pairwise(packets)} == {3600}  # type: ignore[operator]
    assert any(pts != dts and later_pts < pts for (pts, dts, _), (later_pts, _, _) in pairwise(packets))  # type: ignore[operator]
    assert probe(joined).frame_rate == 25
    with av.open(str(joined)) as opened:
        assert opened.streams.video[0].duration == 34 * 3600


@pytest.mark.parametrize("codec", ["h264", "hevc", "vp9", "av1"])
def test_parts_begin_with_a_key_picture_and_need_no_other(codec: str, tmp_path: Path) -> None:
    """So that decoding begins at each bound as well, and gives the same pixels."""
    frames, info = _frames("yuv420p"), _info("yuv420p")
    plan = make_plan(info, container="mp4", codec=codec)
    joined = _join(_write_parts(tmp_path, frames, info, plan), tmp_path / "a.mp4", info, plan)
    whole = list(read_frames(joined))
    for start in _BOUNDS[1:-1]:
        for frame, same in zip(read_frames(joined, start=start), whole[start:], strict=True):
            assert frame.pts == same.pts
            np.testing.assert_array_equal(frame.planes[0], same.planes[0])
    with av.open(str(joined)) as opened:
        keys = [packet.pts for packet in opened.demux(video=0) if packet.size and packet.is_keyframe]
    assert {frames[start].pts for start in _BOUNDS[:-1]} <= set(keys)


@pytest.mark.parametrize(
    ("rich", "containers"),
    [
        (
            Rich(
                ".mov",
                sounds=[Other("aac", "deu", "Ton"), Other("pcm_s16le", "eng")],
                tags={"title": "A walk", "artist": "them"},
                timecode="01:00:00:00",
                chapters=2,
            ),
            ("mov", "mp4", "mkv"),
        ),
        (
            Rich(".mkv", sounds=[Other("libopus", "eng")], subtitles=[Other("srt", "fra")], attachment=b"font" * 9),
            ("mkv", "webm"),
        ),
        (Rich(".mov", "libx264", size=(256, 128), fields="tff", options={"x264-params": "tff=1"}), ("mp4", "mkv")),
    ],
)
def test_all_else_goes_along_at_the_join(rich: Rich, containers: Sequence[str], tmp_path: Path) -> None:
    source = rich.write(tmp_path, "source")
    info, streams, frames = probe(source), read_streams(source), list(read_frames(source))
    for container in containers:
        plan = make_plan(info, container=container, source=source, streams=streams)
        parts = _write_parts(tmp_path, frames, info, plan, (0, 3, 6))
        whole = _whole(tmp_path / f"whole.{container}", frames, info, plan)
        joined = _join(parts, tmp_path / f"joined.{container}", info, plan, 6)
        again = _join(parts, tmp_path / f"again.{container}", info, plan, 6)
        assert joined.read_bytes() == again.read_bytes()
        assert read_streams(joined) == read_streams(whole)
        assert probe(joined).has_audio == bool(rich.sounds)
        if rich.sounds:
            assert sound_packets(joined) == sound_packets(whole)
        assert [frame.pts for frame in read_frames(joined)] == [frame.pts for frame in read_frames(whole)]


def test_alpha_is_joined(tmp_path: Path) -> None:
    info = replace(_info("yuv444p10le"), has_alpha=True)
    alpha = np.tile(np.linspace(0, 1023, _SIZE[0]).astype(np.uint16), (_SIZE[1], 1))
    frames = [replace(frame, alpha=np.roll(alpha, frame.index, 1)) for frame in _frames("yuv444p10le", 18)]
    plan = make_plan(info, container="mkv", codec="ffv1")
    joined = _join(_write_parts(tmp_path, frames, info, plan, (0, 8, 18)), tmp_path / "a.mkv", info, plan, 18)
    for frame, before in zip(read_frames(joined), frames, strict=True):
        np.testing.assert_array_equal(frame.alpha, before.alpha)
        np.testing.assert_array_equal(frame.planes[0], before.planes[0])


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], MediaInfo, Plan]:
    info = _info("yuv420p")
    plan = make_plan(info, container="mp4", codec="h264")
    return _write_parts(tmp_path_factory.mktemp("parts"), _frames("yuv420p"), info, plan), info, plan


def test_a_missing_swapped_or_foreign_part_is_refused(
    drawn: tuple[list[Path], MediaInfo, Plan], tmp_path: Path
) -> None:
    (a, b, c), info, plan = drawn
    out = tmp_path / "out.mp4"
    for parts, facts, message in (
        ([a, c], {}, "not those from 9"),
        ([a, b], {}, "20 frames of 34"),
        ([b, c], {}, "not those from 0"),
        ([a, c, b], {}, "not those from 9"),
        ([a, b, b], {}, "not those from 20"),
        ([], {}, "0 frames of 34"),
        ([a, b, tmp_path / "none.part"], {}, "cannot be read"),
        ([a, b, c], {"source_sha256": "1" * 64}, "another clip"),
        ([a, b, c], {"crf": 30}, "another manner"),
        ([a, b, c], {"preset": "slow"}, "another manner"),
        ([a, b, c], {"count": 35}, "another clip"),
    ):
        with pytest.raises(MediaError, match=message):
            _join(parts, out, info, plan, **facts)  # type: ignore[arg-type]
        assert not out.exists()
    other = make_plan(info, container="mp4", codec="hevc")
    with pytest.raises(MediaError, match="another manner"):
        _join([a, b, c], out, info, other)
    assert not out.exists()


def test_a_truncated_or_altered_part_is_refused(drawn: tuple[list[Path], MediaInfo, Plan], tmp_path: Path) -> None:
    (a, b, c), info, plan = drawn
    out, bad, data = tmp_path / "out.mp4", tmp_path / "bad.part", c.read_bytes()
    size = len(data)
    changed = [data[:keep] for keep in (0, 4, 10, 300, size // 2, size - 40, size - 1)]
    changed += [data + b"x", data + data]
    rng = np.random.default_rng(7)
    for at in (0, 9, 20, *rng.integers(12, size, 60).tolist(), size - 1, size - 33, size - 40, size - 60):
        turned = bytearray(data)
        turned[at] ^= 1 << int(rng.integers(8))
        changed.append(bytes(turned))
    for one in changed:
        bad.write_bytes(one)
        with pytest.raises(MediaError, match=r"bad\.part"):
            _join([a, b, bad], out, info, plan)
        assert not out.exists()
    assert _join([a, b, c], out, info, plan).exists()


@pytest.mark.parametrize("facts", [{"start": "0"}, {"stop": 34.0}, {"stop": None}, {"start": True}])
def test_a_part_whose_head_counts_in_no_whole_numbers_is_damaged(
    facts: dict[str, Any], drawn: tuple[list[Path], MediaInfo, Plan], tmp_path: Path
) -> None:
    data, bad = drawn[0][0].read_bytes(), tmp_path / "bad.part"
    length = int.from_bytes(data[8:12], "little")
    head = json.dumps(json.loads(data[12 : 12 + length]) | facts).encode()
    bad.write_bytes(data[:8] + len(head).to_bytes(4, "little") + head + data[12 + length :])
    with pytest.raises(PartError, match=r"bad\.part: the part is damaged"), PartReader(bad):
        pass


def test_the_same_frames_give_the_same_part(drawn: tuple[list[Path], MediaInfo, Plan], tmp_path: Path) -> None:
    parts, info, plan = drawn
    frames = _frames("yuv420p")
    assert [hashlib.sha256(path.read_bytes()).digest() for path in _write_parts(tmp_path, frames, info, plan)] == [
        hashlib.sha256(path.read_bytes()).digest() for path in parts
    ]


def test_a_part_that_cannot_be_begun_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = _info("yuv420p")
    encoder = PictureEncoder(info, info.format, make_plan(info, container="mp4"), part=True)
    writer = PartWriter(tmp_path / "a.part", encoder, ClipOfParts(_SHA, 9, None, None, _MADE_BY), start=0, stop=9)
    files = []

    def full(_: PartWriter, __: bytes) -> None:
        files.append(writer._file)
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(PartWriter, "_put", full)
    with pytest.raises(OSError, match="full"), writer:
        pass
    assert [file.closed for file in files] == [True]
    assert list(tmp_path.iterdir()) == []


def test_pipes_and_pictures_are_not_joined() -> None:
    assert can_join("mp4")
    assert can_join(".mkv", "ffv1")
    for container, codec in (("nut", "auto"), ("y4m", "auto"), ("png", "auto"), ("mp4", "raw"), ("mp4", "theora")):
        assert not can_join(container, codec)


def test_two_idr_pictures_never_stand_side_by_side(tmp_path: Path) -> None:
    """H.264 tells them by idr_pic_id, with which every part begins anew; a cut before the last frame would make one."""
    frames, info = _frames("yuv420p", 48, even=True), _info("yuv420p")
    frames[29:] = [replace(frame, planes=tuple(255 - plane for plane in frame.planes)) for frame in frames[29:]]
    plan = make_plan(info, container="mp4", codec="h264")
    ends = []
    for bounds in ((0, 30, 48), (0, 31, 48)):
        joined = _join(_write_parts(tmp_path, frames, info, plan, bounds), tmp_path / "a.mp4", info, plan, 48)
        with av.open(str(joined)) as opened:
            packets = [packet for packet in opened.demux(video=0) if packet.size]
        ends.append([packet.pts // 3600 - 1 for packet in packets if packet.is_keyframe and packet.pts is not None])
    assert ends == [[0, 30], [0, 29, 31]]
