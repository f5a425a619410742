from __future__ import annotations

import tracemalloc
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.video import frame_at, key_pictures, probe, read_frames
from pvg.video.opening import OpenClip
from tests.gallery.clips import (
    encode_raw,
    every_frame,
    libav_frame,
    write_clip,
)
from tests.gallery.pictures import colorful


@pytest.mark.parametrize("codec", ["mpeg4", "mjpeg", "libx264"])
def test_avi_clips_are_read_in_order_with_even_steps(codec: str, tmp_path: Path) -> None:
    layout = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    base = colorful(7)
    raw = [libav_frame(np.roll(base, 3 * k, 1), layout) for k in range(9)]
    path = encode_raw(tmp_path / "clip.avi", raw, codec)
    frames = list(read_frames(path))
    assert len(frames) == probe(path).frame_count == 9
    times = np.array([frame.time_s for frame in frames])
    np.testing.assert_allclose(np.diff(times), 0.04, atol=1e-6)
    for k, frame in enumerate(frames):  # the right picture at the right place
        errors = [np.abs(frame.rgb().astype(int) - np.roll(base, 3 * j, 1)).mean() for j in range(9)]
        assert int(np.argmin(errors)) == k


@pytest.mark.parametrize("codec", ["mpeg4", "libx264"])
@pytest.mark.parametrize("reordered", ["0", "2"])
def test_gaps_between_the_pictures_of_an_avi_are_kept(codec: str, reordered: str, tmp_path: Path) -> None:
    path, base, shown = tmp_path / "clip.avi", colorful(7), [*range(6), *range(20, 30)]
    with av.open(str(path), "w") as output:
        stream: Any = output.add_stream(codec, rate=25, options={"bf": reordered, "b_strategy": "0"})
        stream.width, stream.height, stream.pix_fmt = base.shape[1], base.shape[0], "yuv420p"
        for k in shown:
            picture = libav_frame(np.roll(base, 3 * k, 1))
            picture.pts, picture.time_base = k, Fraction(1, 25)
            output.mux(stream.encode(picture))
        output.mux(stream.encode(None))
    frames = list(read_frames(path))
    assert len(frames) == len(shown)
    times = np.array([frame.time_s for frame in frames])
    assert times[-1] - times[0] == pytest.approx((shown[-1] - shown[0]) / 25, abs=0.09)
    assert np.diff(times).max() == pytest.approx(0.56, abs=0.09)


def test_a_long_clip_is_read_a_few_frames_at_a_time(long_clip: Path) -> None:
    tracemalloc.start()
    try:
        count = sum(1 for _ in read_frames(long_clip))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert count == 600
    assert peak < 20 * (160 * 96 * 3 // 2)  # planes of 20 frames out of 600


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".avi"])
def test_any_range_equals_that_part_of_the_whole(suffix: str, long_clip: Path, tmp_path: Path) -> None:
    path = long_clip
    if suffix == ".webm":
        path = write_clip(tmp_path / "clip.webm", list(read_frames(long_clip, stop=100)), probe(long_clip))
    elif suffix == ".avi":
        raw = [libav_frame(colorful(k)) for k in range(40)]
        path = encode_raw(tmp_path / "clip.avi", raw, "mpeg4", g="10")
    whole = [(frame.index, frame.pts, frame.planes[0].tobytes()) for frame in read_frames(path)]
    last = len(whole)
    for start, stop in (
        (0, 3),
        (1, 2),
        (23, 26),
        (24, 25),
        (last - 1, None),
        (last // 2, last // 2 + 30),
        (last, None),
    ):
        part = [
            (frame.index, frame.pts, frame.planes[0].tobytes()) for frame in read_frames(path, start=start, stop=stop)
        ]
        assert part == whole[start:stop]


def test_a_clip_that_cannot_be_sought_in_is_decoded_from_its_beginning(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clip = encode_raw(tmp_path / "i.mp4", [libav_frame(colorful(3))] * 3, "libx264", g="1")
    frames = list(read_frames(clip))

    def refuse(self: OpenClip, pts: int) -> None:
        raise av.error.PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(OpenClip, "seek", refuse)
    (seen,) = read_frames(clip, start=2)
    assert (seen.index, seen.pts) == (2, frames[2].pts)
    np.testing.assert_array_equal(seen.planes[0], frames[2].planes[0])


def test_an_impossible_range_is_a_value_error(long_clip: Path) -> None:
    for start, stop in ((-1, None), (5, 4)):
        with pytest.raises(ValueError, match="range"):
            next(read_frames(long_clip, start=start, stop=stop))


# the labelled media


def test_odd_clips_are_read(media_dir: Path) -> None:
    odd = media_dir / "odd"
    read = {}
    for path in sorted(odd.iterdir()):
        if path.name.startswith("bad_") or path.suffix in (".md", ".gif"):
            continue
        read[path.name] = every_frame(path)
        assert read[path.name] == probe(path).frame_count or path.name == "interlaced_tff.mp4", path.name
    assert len(read) >= 18
    assert read["single_frame.mp4"] == 1
    assert read["portrait_exif_orientation6.jpg"] == 1
    assert (
        min(count for name, count in read.items() if name not in ("single_frame.mp4", "portrait_exif_orientation6.jpg"))
        > 20
    )


def test_frames_that_cannot_be_decoded_do_not_move_the_numbers_of_others(tmp_path: Path) -> None:
    """A clip cut at an open group begins with pictures that need one before: decoders skip them, packets name them."""
    raw = [libav_frame(np.roll(colorful(9, (160, 96)), 3 * k, 1)) for k in range(60)]
    params = "keyint=12:min-keyint=12:open-gop=1:scenecut=0:bframes=3:b-adapt=0:log-level=none"
    source = encode_raw(tmp_path / "source.mp4", raw, "libx265", **{"x265-params": params})
    cut = tmp_path / "cut.mkv"
    with av.open(str(source)) as opened, av.open(str(cut), "w") as output:
        packets = [packet for packet in opened.demux(video=0) if packet.size]
        begin = [k for k, packet in enumerate(packets) if packet.is_keyframe][1]
        stream = output.add_stream_from_template(opened.streams.video[0])
        for packet in packets[begin:]:
            packet.stream = stream
            output.mux_one(packet)
    frames = list(read_frames(cut))
    assert 40 < len(frames) < len(packets) - begin
    for start in (1, 20, len(frames) - 1):
        for count in (len(frames), None):
            seen = list(read_frames(cut, start=start, frame_count=count))
            assert [(one.index, one.pts) for one in seen] == [(one.index, one.pts) for one in frames[start:]]
            np.testing.assert_array_equal(seen[0].planes[0], frames[start].planes[0])
    assert key_pictures(cut) is None
    assert frame_at(cut, 1.0) is None
