"""Frames in and out of clips: colours, time, rotation, sound."""

from __future__ import annotations

import itertools
import tracemalloc
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.errors import MediaError
from pvg.video import Frame, PixelFormat, VideoWriter, probe, read_frames, sha256_file
from pvg.video.formats import RGB24, is_high_definition, resolve_format
from pvg.video.reading import Reading, reading_of, to_frame
from tests.pvg.clips import (
    SIZE,
    add_tone,
    encode_raw,
    media_info,
    noise_planes,
    picture,
    pixel_format,
    short_clip,
    smooth_frames,
    sound_packets,
    tone_onset,
    write_clip,
)

FORMATS = [
    resolve_format(f"yuv{chroma}p{depth}", *SIZE, matrix, color_range)
    for chroma in ("420", "422", "444")
    for depth in ("", "10le", "12le")
    for matrix, color_range in ((1, 1), (6, 2), (9, 1))
]


# --- colours --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "matrix", "color_range", "rgb", "codes"),
    [  # published code values of colour bars
        ("yuv420p", 6, 1, (255, 0, 0), (81, 90, 240)),
        ("yuv420p", 6, 1, (0, 255, 0), (145, 54, 34)),
        ("yuv420p", 1, 1, (255, 0, 0), (63, 102, 240)),
        ("yuv420p", 1, 1, (0, 0, 255), (32, 240, 118)),
        ("yuv420p", 1, 1, (255, 255, 255), (235, 128, 128)),
        ("yuv420p", 6, 2, (255, 255, 255), (255, 128, 128)),
        ("yuv420p10le", 1, 1, (255, 0, 0), (250, 409, 960)),
        ("yuv420p10le", 9, 1, (0, 0, 0), (64, 512, 512)),
        ("yuv444p12le", 9, 1, (255, 255, 255), (3760, 2048, 2048)),
    ],
)
def test_primaries_have_the_published_code_values(
    name: str, matrix: int, color_range: int, rgb: tuple[int, int, int], codes: tuple[int, int, int]
) -> None:
    fmt = pixel_format(name, matrix, color_range)
    planes = fmt.from_rgb(np.broadcast_to(np.array(rgb), (4, 6, 3)))
    assert tuple(int(plane[0, 0]) for plane in planes) == codes
    np.testing.assert_allclose(fmt.matrix @ rgb + fmt.offset, codes, atol=0.51)


@settings(deadline=None, max_examples=40)
@given(fmt=st.sampled_from(FORMATS), color=st.tuples(*[st.integers(0, 255)] * 3), odd=st.booleans())
def test_a_flat_colour_survives_the_planes(fmt: PixelFormat, color: tuple[int, int, int], odd: bool) -> None:
    shape = (5, 7, 3) if odd else (4, 6, 3)
    back = fmt.to_rgb(fmt.from_rgb(np.broadcast_to(np.array(color, dtype=float), shape)))
    # half a code value a plane, through the inverse matrix
    worst = np.abs(np.linalg.inv(fmt.matrix)).sum(axis=1).max() * 0.5
    assert back.shape == shape
    assert np.abs(back - color).max() <= worst + 1e-9


@settings(deadline=None, max_examples=40)
@given(fmt=st.sampled_from([*FORMATS, RGB24]), seed=st.integers(0, 99), size=st.sampled_from([(24, 16), (13, 9)]))
def test_fast_rgb_is_the_exact_rgb_within_two_levels(fmt: PixelFormat, seed: int, size: tuple[int, int]) -> None:
    planes = noise_planes(fmt, seed, size)
    exact = np.clip(fmt.to_rgb(planes), 0, 255)
    fast = Frame(0, 0, 0.0, fmt, planes).rgb()
    assert fast.dtype == np.uint8
    # chroma is rounded after it is raised: half a code value, times at most 2.14, and half a level; the rest of 2.25
    # is the single precision it is raised in
    assert np.abs(fast - exact).max() <= (2.0 if fmt.depth == 8 else 0.5 + 0.5 * 2.25 / 2 ** (fmt.depth - 8))


def test_rgb_agrees_with_swscale_in_every_matrix_and_range() -> None:
    for matrix, color_range in ((1, 1), (1, 2), (6, 1), (6, 2)):
        fmt = pixel_format("yuv444p", matrix, color_range)
        frame = Frame(0, 0, 0.0, fmt, fmt.from_rgb(picture(3)))
        raw = av.VideoFrame(*SIZE, "yuv444p")
        for target, plane in zip(raw.planes, frame.planes, strict=True):
            target.update(np.pad(plane, ((0, 0), (0, target.line_size - plane.shape[1]))).tobytes())
        scaled = raw.reformat(
            format="rgb24", src_colorspace=matrix, src_color_range=color_range, dst_color_range=2, interpolation=0x42010
        ).to_ndarray()
        # swscale's 8-bit tables are off by a level here and there; a wrong matrix or range is off by several
        assert np.abs(frame.rgb().astype(int) - scaled).mean() < 0.7


def test_untagged_colours_follow_the_size_whatever_the_rotation() -> None:
    for size, expected in (((640, 480), (0.299, 0.114)), ((1280, 720), (0.2126, 0.0722))):
        assert resolve_format("yuv420p", *size, 2, 0).luma_weights == expected
        assert is_high_definition(*size) == is_high_definition(*size[::-1])
    assert not resolve_format("yuv420p", 640, 480, 2, 0).full_range
    assert resolve_format("yuvj420p", 640, 480, 2, 0).full_range


def test_a_matrix_that_is_not_linear_ycbcr_is_refused() -> None:
    with pytest.raises(MediaError, match="matrix 14"):
        resolve_format("yuv420p", 64, 64, 14, 1)


def test_with_planes_keeps_the_instant_and_refuses_other_shapes() -> None:
    frame = smooth_frames(3, pixel_format())[2]
    before = frame.rgb().copy()
    y, u, v = frame.planes
    changed = frame.with_planes((255 - y, u, v))
    assert (changed.index, changed.pts, changed.time_s) == (frame.index, frame.pts, frame.time_s)
    assert not np.array_equal(changed.rgb(), before)
    np.testing.assert_array_equal(frame.rgb(), before)
    with pytest.raises(ValueError, match="plane is"):
        frame.with_planes((y, y, y))


@pytest.mark.parametrize(
    ("coded", "delivered"),
    [
        ("nv12", "yuv420p"),
        ("yuyv422", "yuv422p"),
        ("yuva420p", "yuv420p"),
        ("p010le", "yuv420p10le"),
        ("yuv420p9le", "yuv420p10le"),
        ("yuv444p16le", "yuv444p12le"),
        ("yuv411p", "yuv422p"),
        ("yuv440p", "yuv444p"),
        ("gray", "yuv420p"),
        ("gray10le", "yuv420p10le"),
        ("rgb24", "gbrp"),
        ("bgra", "gbrp"),
        ("gbrp10le", "gbrp"),
    ],
)
def test_other_layouts_become_the_nearest_one_with_the_same_colours(coded: str, delivered: str) -> None:
    rgb = picture(5)
    if coded.startswith("gray"):
        rgb = np.repeat(rgb[..., 1:2], 3, axis=2)
    raw = av.VideoFrame.from_ndarray(rgb, format="rgb24")
    raw = raw.reformat(format=coded, dst_colorspace=5, src_color_range=2, dst_color_range=2, interpolation=0x42010)
    target = resolve_format(coded, *SIZE, 6, 2)
    assert target.name == delivered
    frame = to_frame(raw, Reading(SIZE, coded, target, _upright()), 0, 0, Fraction(1, 25))
    assert [plane.shape for plane in frame.planes] == list(target.plane_shapes(*SIZE))
    # what chroma at a half or a quarter of the size costs this picture: 2.2 and 4.4 levels
    assert np.abs(frame.rgb().astype(int) - rgb).mean() < (5.0 if coded == "yuv411p" else 2.5)


def _upright() -> Any:
    raw = av.VideoFrame(*SIZE, "yuv420p")

    class Context:
        color_range, colorspace = 1, 1

    class Clip:
        name = "clip"
        stream = type("Stream", (), {"codec_context": Context})

    clip: Any = Clip
    return reading_of(clip, raw).orientation


# --- a round trip ---------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(("suffix", "codec"), [(".mp4", "auto"), (".webm", "vp9"), (".mkv", "hevc"), (".mp4", "av1")])
@pytest.mark.parametrize("tags", [(1, 1, 1, 1), (6, 2, 6, 6), (9, 1, 9, 14)])
def test_colour_tags_are_kept(suffix: str, codec: str, tags: tuple[int, int, int, int], tmp_path: Path) -> None:
    fmt = pixel_format("yuv420p", tags[0], tags[1])
    names = ("color_matrix", "color_range", "color_primaries", "color_transfer")
    info = media_info(fmt, **dict(zip(names, tags, strict=True)))
    seen = probe(write_clip(tmp_path / f"clip{suffix}", smooth_frames(3, fmt), info, codec=codec))
    assert (seen.color_matrix, seen.color_range, seen.color_primaries, seen.color_transfer) == tags
    assert seen.format == fmt


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


def test_an_rgb_clip_is_read_exactly_and_written_as_bt709(tmp_path: Path) -> None:
    pictures = [picture(k) for k in range(4)]
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


@pytest.mark.parametrize("codec", ["mpeg4", "mjpeg", "libx264"])
def test_avi_clips_are_read_in_order_with_even_steps(codec: str, tmp_path: Path) -> None:
    layout = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    base = picture(7)
    raw = [
        av.VideoFrame.from_ndarray(np.roll(base, 3 * k, 1), format="rgb24").reformat(format=layout) for k in range(9)
    ]
    path = encode_raw(tmp_path / "clip.avi", raw, codec)
    frames = list(read_frames(path))
    assert len(frames) == probe(path).frame_count == 9
    times = np.array([frame.time_s for frame in frames])
    np.testing.assert_allclose(np.diff(times), 0.04, atol=1e-6)
    for k, frame in enumerate(frames):  # the right picture at the right place
        errors = [np.abs(frame.rgb().astype(int) - np.roll(base, 3 * j, 1)).mean() for j in range(9)]
        assert int(np.argmin(errors)) == k


# --- rotation -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
@pytest.mark.parametrize("hflip", [False, True])
def test_display_matrices_are_applied(degrees: int, hflip: bool, tmp_path: Path) -> None:
    raw = [av.VideoFrame.from_ndarray(picture(k), format="rgb24").reformat(format="yuv420p") for k in range(3)]
    plain = list(read_frames(encode_raw(tmp_path / "plain.mp4", raw, "libx264", crf="0")))
    turned_path = encode_raw(tmp_path / "turned.mp4", raw, "libx264", degrees=degrees, hflip=hflip, crf="0")
    turned, info = list(read_frames(turned_path)), probe(turned_path)
    assert (info.width, info.height) == (SIZE if degrees in (0, 180) else SIZE[::-1])
    for before, after in zip(plain, turned, strict=True):
        for stored, upright in zip(before.planes, after.planes, strict=True):
            # libav states the turn counterclockwise and mirrors after it
            expected = np.rot90(stored, degrees // 90)
            np.testing.assert_array_equal(upright, expected[:, ::-1] if hflip else expected)
    if not hflip:
        assert info.rotation == -degrees % 360


def test_a_sideways_422_clip_becomes_444(tmp_path: Path) -> None:
    raw = [av.VideoFrame.from_ndarray(picture(2), format="rgb24").reformat(format="yuv422p") for _ in range(2)]
    plain = next(read_frames(encode_raw(tmp_path / "plain.mp4", raw, "libx264", crf="0")))
    turned = next(read_frames(encode_raw(tmp_path / "turned.mp4", raw, "libx264", degrees=90, crf="0")))
    assert turned.format.name == "yuv444p"
    np.testing.assert_array_equal(turned.planes[0], np.rot90(plain.planes[0]))
    assert np.abs(turned.rgb().astype(int) - np.rot90(plain.rgb())).mean() < 1.0


# --- streaming and random access ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """600 frames with a key picture every 24 and reordered frames between them."""
    base = picture(9, (160, 96))
    raw = [
        av.VideoFrame.from_ndarray(np.roll(base, k, 1), format="rgb24").reformat(format="yuv420p") for k in range(600)
    ]
    return encode_raw(tmp_path_factory.mktemp("long") / "clip.mp4", raw, "libx264", g="24", preset="veryfast", bf="3")


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
        raw = [av.VideoFrame.from_ndarray(picture(k), format="rgb24").reformat(format="yuv420p") for k in range(40)]
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


def test_an_impossible_range_is_a_value_error(long_clip: Path) -> None:
    for start, stop in ((-1, None), (5, 4)):
        with pytest.raises(ValueError, match="range"):
            next(read_frames(long_clip, start=start, stop=stop))


# --- sound ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sounding_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 s of pictures and 3 s of sound, silent for its first second."""
    folder = tmp_path_factory.mktemp("sound")
    return add_tone(short_clip(folder / "silent.mp4", 50), 3.0, 1.0, folder / "clip.mp4")


def test_sound_is_copied_byte_for_byte_at_the_same_times(sounding_clip: Path, tmp_path: Path) -> None:
    info = probe(sounding_clip)
    assert (info.has_audio, info.audio_codec) == (True, "aac")
    path = write_clip(tmp_path / "o.mp4", list(read_frames(sounding_clip)), info, audio_from=sounding_clip)
    source, copy = sound_packets(sounding_clip), sound_packets(path)
    assert len(source) > 100
    assert copy == source


@pytest.mark.parametrize("suffix", [".mkv", ".webm"])
def test_sound_stays_in_step_in_other_containers(suffix: str, sounding_clip: Path, tmp_path: Path) -> None:
    frames = list(read_frames(sounding_clip))
    path = write_clip(tmp_path / f"o{suffix}", frames, probe(sounding_clip), audio_from=sounding_clip)
    first = next(read_frames(path)).time_s
    assert probe(path).audio_codec == ("opus" if suffix == ".webm" else "aac")
    assert tone_onset(path) - first == pytest.approx(tone_onset(sounding_clip), abs=0.01)


def test_sound_and_pictures_alternate_in_the_file(sounding_clip: Path, tmp_path: Path) -> None:
    path = write_clip(
        tmp_path / "o.mp4", list(read_frames(sounding_clip)), probe(sounding_clip), audio_from=sounding_clip
    )
    with av.open(str(path)) as clip:
        places = sorted((packet.pos or 0, packet.stream.type) for packet in clip.demux() if packet.size)
    kinds = [kind for _, kind in places]
    assert sum(a != b for a, b in itertools.pairwise(kinds)) > 20


def test_no_sound_is_written_unless_asked_for(sounding_clip: Path, tmp_path: Path) -> None:
    path = write_clip(tmp_path / "o.mp4", list(read_frames(sounding_clip)), probe(sounding_clip))
    assert not probe(path).has_audio


# --- the writer's promises ------------------------------------------------------------------------------------


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


def test_the_digest_is_that_of_the_bytes(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert sha256_file(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
