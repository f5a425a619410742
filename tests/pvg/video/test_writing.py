from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import (
    Frame,
    VideoWriter,
    color_space,
    make_plan,
    probe,
    read_frames,
)
from pvg.video.encoders import Codec
from pvg.video.encoding import PictureEncoder
from pvg.video.formats import resolve_format
from tests.gallery.clips import (
    SIZE,
    encode_raw,
    media_info,
    noise_planes,
    pixel_format,
    short_clip,
    smooth_frames,
    write_clip,
)
from tests.gallery.pictures import colorful


@pytest.mark.parametrize(
    ("name", "codec", "suffix"),
    [
        ("yuv420p", "h264", ".mp4"),
        ("yuv422p", "h264", ".mov"),
        ("yuv444p", "h264", ".mkv"),
        ("yuv420p", "hevc", ".mp4"),
        ("yuv420p10le", "auto", ".mp4"),
        ("yuv422p10le", "hevc", ".mov"),
        ("yuv444p12le", "hevc", ".mkv"),
        ("yuv420p", "auto", ".webm"),
        ("yuv444p", "vp9", ".webm"),
    ],
)
def test_a_lossless_clip_gives_its_planes_and_time_stamps_back(
    name: str, codec: str, suffix: str, tmp_path: Path
) -> None:
    fmt = pixel_format(name)
    # uneven steps, a late start, and (with the encoders' defaults) reordered frames; whole milliseconds for Matroska
    base = Fraction(1, 1000) if suffix in (".mkv", ".webm") else Fraction(1, 90000)
    steps_ms = np.random.default_rng(4).integers(11, 90, 14)
    stamps = (np.cumsum(steps_ms) * int(base.denominator // 1000)).tolist()
    frames = [Frame(k, pts, float(pts * base), fmt, noise_planes(fmt, k // 3)) for k, pts in enumerate(stamps)]
    info = media_info(fmt, time_base=base)
    path = write_clip(tmp_path / f"clip{suffix}", frames, info, codec=codec, crf=0)
    read, seen = list(read_frames(path)), probe(path)
    assert seen.time_base is not None
    assert [frame.pts * seen.time_base for frame in read] == [pts * base for pts in stamps]
    assert [frame.index for frame in read] == list(range(14))
    assert seen.format == fmt
    for frame, source in zip(read, frames, strict=True):
        assert frame.format == fmt
        for plane, expected in zip(frame.planes, source.planes, strict=True):
            np.testing.assert_array_equal(plane, expected)


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_an_hevc_clip_may_be_shorter_than_the_reordering_delay(count: int, suffix: str, tmp_path: Path) -> None:
    # many times, since uninitialised decoding times are wrong only now and then
    for _ in range(8):
        path = short_clip(tmp_path / f"clip{suffix}", count, codec="hevc", preset="slow")
        times = [frame.time_s for frame in read_frames(path)]
        assert times == pytest.approx([k * 0.04 for k in range(count)], abs=5e-4)
        assert probe(path).duration_s == pytest.approx(count * 0.04, abs=2e-3)


@pytest.mark.parametrize("suffix", [".mp4", ".mov"])
@pytest.mark.parametrize(("count", "start"), [(6, 0.02), (13, 0.02), (13, 0.3)])
def test_pictures_of_a_short_hevc_clip_start_late_and_pause_when_they_did(
    count: int, start: float, suffix: str, tmp_path: Path
) -> None:
    fmt, base = pixel_format(), Fraction(1, 15360)
    for pause_at in range(1, count):
        stamps = [round((start + k / 30 + 0.5 * (k >= pause_at)) / base) for k in range(count)]
        frames = [
            replace(frame, pts=pts, duration=0) for frame, pts in zip(smooth_frames(count, fmt), stamps, strict=True)
        ]
        path = write_clip(tmp_path / f"clip{suffix}", frames, media_info(fmt, time_base=base), codec="hevc")
        seen = probe(path)
        assert seen.time_base is not None
        assert [frame.pts * seen.time_base for frame in read_frames(path)] == [pts * base for pts in stamps], pause_at


@pytest.mark.parametrize(("suffix", "codec"), [(".mp4", "auto"), (".webm", "vp9"), (".mkv", "hevc"), (".mp4", "av1")])
@pytest.mark.parametrize("tags", [(1, 1, 1, 1), (6, 2, 6, 6), (9, 1, 9, 14), (9, 1, 9, 16), (9, 1, 9, 18)])
def test_colour_tags_are_kept(suffix: str, codec: str, tags: tuple[int, int, int, int], tmp_path: Path) -> None:
    fmt = pixel_format("yuv420p", tags[0], tags[1])
    names = ("color_matrix", "color_range", "color_primaries", "color_transfer")
    info = media_info(fmt, **dict(zip(names, tags, strict=True)))
    seen = probe(write_clip(tmp_path / f"clip{suffix}", smooth_frames(3, fmt), info, codec=codec))
    assert (seen.color_matrix, seen.color_range, seen.color_primaries, seen.color_transfer) == tags
    assert seen.format == replace(fmt, color=color_space(tags[2], tags[3]))


def test_pictures_of_limited_range_are_not_called_full_since_their_clip_was(tmp_path: Path) -> None:
    """As a pipe may have them: it is what was piped that counts."""
    fmt = pixel_format("yuv420p", 1, 1)
    info = media_info(fmt, color_matrix=1, color_range=2, color_primaries=1, color_transfer=1)
    assert probe(write_clip(tmp_path / "clip.mp4", smooth_frames(3, fmt), info)).color_range == 1


def test_unstated_colours_stay_unstated(tmp_path: Path) -> None:
    fmt = resolve_format("yuv420p", *SIZE, 2, 0)
    info = media_info(fmt, color_matrix=2, color_range=0, color_primaries=2, color_transfer=2)
    seen = probe(write_clip(tmp_path / "clip.mp4", smooth_frames(3, fmt), info))
    assert (seen.color_matrix, seen.color_range, seen.color_primaries, seen.color_transfer) == (2, 0, 2, 2)
    assert seen.format == fmt


def test_rate_duration_and_pixel_aspect_are_kept(tmp_path: Path) -> None:
    frames = smooth_frames(10, pixel_format())
    frames[-1] = replace(frames[-1], duration=5120)  # the last frame stays for 0.4 s
    info = media_info(frames[0].format, sample_aspect_ratio=Fraction(4, 3))
    seen = probe(write_clip(tmp_path / "clip.mp4", frames, info))
    assert seen.duration_s == pytest.approx(9 / 25 + 0.4)
    assert (seen.frame_count, seen.sample_aspect_ratio) == (10, Fraction(4, 3))
    even = probe(write_clip(tmp_path / "even.mp4", smooth_frames(10, pixel_format())))
    assert even.frame_rate == 25


@pytest.mark.parametrize(
    ("suffix", "codec"),
    [
        *[(".mp4", codec) for codec in ("h264", "hevc", "vp9", "av1")],
        *[(".mkv", codec) for codec in ("h264", "hevc", "vp9", "av1", "ffv1", "prores")],
        *[(".mov", "prores"), (".webm", "vp9"), (".webm", "av1")],
    ],
)
@pytest.mark.parametrize("aspect", [Fraction(4, 3), Fraction(3, 8)], ids=("wide", "narrow"))
def test_a_pixel_aspect_is_kept(suffix: str, codec: Codec, aspect: Fraction, tmp_path: Path) -> None:
    frames = smooth_frames(3, pixel_format())
    info = media_info(frames[0].format, sample_aspect_ratio=aspect)
    seen = probe(write_clip(tmp_path / f"clip{suffix}", frames, info, codec=codec))
    assert seen.sample_aspect_ratio == aspect
    assert not [line for line in make_plan(info, container=suffix, codec=codec).dropped if "pixels" in line]


@pytest.mark.parametrize(
    ("codec", "suffix", "kept"),
    [("h264", ".mp4", (96, 70)), ("hevc", ".mp4", (96, 70)), ("vp9", ".webm", (97, 71)), ("av1", ".webm", (97, 71))],
)
def test_odd_sizes_lose_a_line_only_where_the_codec_must(
    codec: str, suffix: str, kept: tuple[int, int], tmp_path: Path
) -> None:
    frames = smooth_frames(3, pixel_format(), (97, 71))
    path = write_clip(tmp_path / f"clip{suffix}", frames, codec=codec, crf=10)
    seen = list(read_frames(path))
    assert {(frame.width, frame.height) for frame in seen} == {kept}
    expected = frames[0].rgb()[: kept[1], : kept[0]].astype(int)
    assert np.abs(seen[0].rgb() - expected).mean() < 4.0


def test_a_depth_or_chroma_the_codec_lacks_becomes_the_nearest(tmp_path: Path) -> None:
    for name, codec, suffix, expected in (
        ("yuv420p10le", "vp9", ".webm", "yuv420p"),
        ("yuv422p10le", "av1", ".mp4", "yuv420p10le"),
        ("yuv420p12le", "h264", ".mp4", "yuv420p10le"),
    ):
        frames = smooth_frames(4, pixel_format(name))
        seen = next(read_frames(write_clip(tmp_path / f"{codec}{suffix}", frames, codec=codec, crf=5)))
        assert seen.format.name == expected
        assert np.abs(seen.rgb().astype(int) - frames[0].rgb()).mean() < 3.0


@pytest.mark.parametrize(("name", "codec"), [("yuv420p", "prores4444"), ("gbrp", "prores")])
def test_no_row_of_a_converted_picture_is_written_over_by_the_one_above(name: str, codec: str, tmp_path: Path) -> None:
    """libav's scaler writes past the ends of rows that no whole registers fill."""
    size, fmt = (450, 450), pixel_format(name)
    rgb = np.broadcast_to(np.uint8([150, 140, 130]), (size[1], size[0], 3))
    frames = [Frame(k, 512 * k, 0.04 * k, fmt, fmt.from_rgb(rgb)) for k in range(24)]
    for frame in read_frames(write_clip(tmp_path / "clip.mov", frames, codec=codec)):
        luma = frame.planes[0]
        assert abs(luma.astype(int) - int(luma[0, -1])).max() < 8


def test_an_rgb_clip_is_read_exactly_and_written_as_bt709(tmp_path: Path) -> None:
    pictures = [colorful(k) for k in range(4)]
    raw = [av.VideoFrame.from_ndarray(rgb, format="rgb24") for rgb in pictures]
    source = encode_raw(tmp_path / "rgb.mov", raw, "png")
    frames, info = list(read_frames(source)), probe(source)
    assert info.format.is_rgb
    for frame, rgb in zip(frames, pictures, strict=True):
        np.testing.assert_array_equal(frame.rgb(), rgb)
    written = write_clip(tmp_path / "out.mp4", frames, info, crf=0)
    seen = list(read_frames(written))
    assert (seen[0].format.name, probe(written).color_matrix) == ("yuv444p", 1)
    assert np.abs(seen[2].rgb().astype(int) - pictures[2]).mean() < 1.5


def test_a_partial_file_is_removed_when_the_block_fails(sounding_clip: Path, tmp_path: Path) -> None:
    fmt, path = pixel_format(), tmp_path / "clip.mp4"
    info = replace(media_info(fmt), has_audio=True)

    def stop_half_way() -> None:
        with VideoWriter(path, info, fmt, audio_from=sounding_clip) as writer:
            for frame in smooth_frames(30, fmt):
                writer.write(frame)
            assert path.exists()
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        stop_half_way()
    assert not path.exists()
    with pytest.raises(ValueError, match="no frame"), VideoWriter(path, info, fmt):
        pass
    assert not path.exists()
    with pytest.raises(MediaError), VideoWriter(path, info, fmt, audio_from=tmp_path / "missing.mp4"):
        pass
    assert not path.exists()


@pytest.mark.parametrize("codec", ["h264", "hevc", "vp9", "av1"])
def test_every_codec_knows_the_names_of_presets(codec: str, tmp_path: Path) -> None:
    fmt = pixel_format()
    sizes = {}
    for preset in ("ultrafast", "veryfast", "slow"):
        path = tmp_path / f"{preset}.mkv"
        with VideoWriter(path, media_info(fmt), fmt, codec=codec, preset=preset) as writer:
            for frame in smooth_frames(6, fmt):
                writer.write(frame)
        assert probe(path).frame_count == 6
        sizes[preset] = path.read_bytes()
    assert sizes["ultrafast"] != sizes["slow"]


def test_options_that_do_not_fit_are_refused_before_a_file_is_made(tmp_path: Path) -> None:
    fmt = pixel_format()
    for name, options, message in (
        ("clip.gif", {}, "written as"),
        ("clip.webm", {"codec": "h264"}, "WebM"),
        ("clip.mov", {"codec": "vp9"}, "MOV"),
        ("clip.mp4", {"codec": "theora"}, "theora"),
    ):
        with pytest.raises(ValueError, match=message):
            VideoWriter(tmp_path / name, media_info(fmt), fmt, **options)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="time base"):
        VideoWriter(tmp_path / "clip.mp4", media_info(fmt, time_base=None), fmt)
    with pytest.raises(ValueError, match="too small"):
        VideoWriter(tmp_path / "clip.mp4", media_info(fmt, (1, 1)), fmt)
    assert list(tmp_path.iterdir()) == []


def test_frames_of_another_size_format_or_past_time_are_refused(tmp_path: Path) -> None:
    frames = smooth_frames(2, pixel_format())
    with VideoWriter(tmp_path / "clip.mp4", media_info(pixel_format()), pixel_format()) as writer:
        writer.write(frames[1])
        with pytest.raises(ValueError, match="does not follow"):
            writer.write(frames[0])
        with pytest.raises(ValueError, match="was made for"):
            writer.write(smooth_frames(1, pixel_format(), (64, 64))[0])
        with pytest.raises(ValueError, match="was made for"):
            writer.write(smooth_frames(1, pixel_format("yuv444p"))[0])


def test_the_container_can_be_named_apart_from_the_path(tmp_path: Path) -> None:
    path = short_clip(tmp_path / "clip.partial", 3, container=".webm")
    assert probe(path).codec in ("vp9", "libvpx-vp9")


# the labelled media


def test_variable_frame_rates_pass_through_exactly(media_dir: Path, tmp_path: Path) -> None:
    source = media_dir / "odd" / "vfr_jittered.mp4"
    info = probe(source)
    stamps = [frame.pts for frame in read_frames(source)]
    assert len(set(np.diff(stamps).tolist())) > 3
    with VideoWriter(tmp_path / "out.mp4", info, info.format, audio_from=source) as writer:
        for frame in read_frames(source):
            writer.write(frame)
    seen = probe(tmp_path / "out.mp4")
    assert seen.time_base is not None
    assert info.time_base is not None
    written = [frame.pts * seen.time_base for frame in read_frames(tmp_path / "out.mp4")]
    assert written == [pts * info.time_base for pts in stamps]


def test_ten_bits_stay_ten_bits(media_dir: Path, tmp_path: Path) -> None:
    for name in ("hevc_10bit.mp4", "prores_proxy.mov"):
        source = media_dir / "odd" / name
        info = probe(source)
        assert info.format.depth == 10
        with VideoWriter(tmp_path / "out.mp4", info, info.format) as writer:
            for frame in read_frames(source, stop=5):
                writer.write(frame)
        seen = next(read_frames(tmp_path / "out.mp4"))
        assert seen.format == info.format
        first = next(read_frames(source))
        assert np.abs(seen.planes[0].astype(int) - first.planes[0]).mean() < 8  # of 1023


@pytest.mark.parametrize("size", [(641, 479), (640, 479), (641, 480), (131, 97), (97, 131), (1081, 719), (96, 64)])
@pytest.mark.parametrize("name", ["yuv420p", "yuv422p", "yuv444p", "yuv420p10le"])
def test_ffv1_is_lossless_in_every_size(name: str, size: tuple[int, int], tmp_path: Path) -> None:
    """Its slices begin between samples of chroma, which four of them do not in every odd size."""
    fmt = resolve_format(name, *size, 1, 1)
    frames = [Frame(k, 512 * k, 0.0, fmt, noise_planes(fmt, k, size)) for k in range(2)]
    path = write_clip(tmp_path / "clip.mkv", frames, media_info(fmt, size), codec="ffv1")
    read = list(read_frames(path))
    assert len(read) == 2
    for one, other in zip(frames, read, strict=True):
        for plane, back in zip(one.planes, other.planes, strict=True):
            np.testing.assert_array_equal(plane, back)


@pytest.mark.parametrize(("suffix", "codec"), [(".mkv", "h264"), (".webm", "vp9"), (".mp4", "h264"), (".mov", "h264")])
def test_the_same_frames_give_the_same_bytes(suffix: str, codec: str, tmp_path: Path) -> None:
    frames = smooth_frames(12, pixel_format())
    paths = [write_clip(tmp_path / f"{k}{suffix}", frames, codec=codec, threads=1) for k in range(2)]
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize(
    ("suffix", "codec", "once"), [(".mp4", "h264", True), (".mp4", "hevc", True), (".mkv", "ffv1", False)]
)
def test_pictures_are_filled_again_where_their_encoder_has_copied_them(
    suffix: str, codec: str, once: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """x264 and x265 do; of others each frame has a picture of its own. No picture shows in another's place."""
    filled: list[int] = []
    blank = PictureEncoder._blank

    def noted(self: PictureEncoder, layout: str) -> av.VideoFrame:
        picture = blank(self, layout)
        filled.append(picture.planes[0].buffer_ptr)
        held.append(picture)
        return picture

    held: list[av.VideoFrame] = []
    monkeypatch.setattr(PictureEncoder, "_blank", noted)
    frames = smooth_frames(30, pixel_format())
    path = write_clip(
        tmp_path / f"c{suffix}", frames, codec=codec, threads=1, **({} if codec == "ffv1" else {"crf": 0})
    )
    assert len(set(filled)) == (1 if once else 30)
    for frame, back in zip(frames, read_frames(path), strict=True):
        np.testing.assert_array_equal(frame.planes[0], back.planes[0])


@pytest.mark.parametrize(
    ("codec", "options", "words"),
    [
        ("h264", {"crf": 52}, "crf of H.264 is a whole number from 0 to 51, not 52"),
        ("av1", {"crf": -1}, "crf of AV1 is a whole number from 0 to 63, not -1"),
        ("hevc", {"crf": 20.0}, "crf of HEVC is a whole number"),
        ("hevc", {"preset": "7"}, "preset of HEVC is one of"),
        ("av1", {"preset": "14"}, "preset of AV1 is one of .* or 0 to 13, not '14'"),
        ("ffv1", {"preset": "fast"}, "FFV1 has no preset"),
    ],
)
def test_a_scale_that_the_encoder_does_not_have_is_refused(
    codec: str, options: dict[str, object], words: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=words):
        write_clip(tmp_path / "clip.mkv", smooth_frames(2, pixel_format()), codec=codec, **options)
    assert list(tmp_path.iterdir()) == []
