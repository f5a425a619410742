"""Decoded pictures as upright frames, by what their clip says of them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import make_plan, probe, read_frames, read_streams
from pvg.video.decoding import DecodingPlan, decoding_plan, to_frame
from pvg.video.formats import LUMA_WEIGHTS, resolve_format
from pvg.video.jpeg import into_jpeg
from pvg.video.metadata_record import PictureMetadata
from pvg.video.opening import StatedColors
from tests.gallery.clips import (
    SIZE,
    color_container,
    encode_raw,
    libav_frame,
    media_info,
    pixel_format,
    smooth_frames,
    write_clip,
)
from tests.gallery.pictures import colorful


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
        ("gbrp10le", "gbrp10le"),
        ("rgb48le", "gbrp16le"),
    ],
)
def test_other_layouts_become_the_nearest_one_with_the_same_colours(coded: str, delivered: str) -> None:
    rgb = colorful(5)
    if coded.startswith("gray"):
        rgb = np.repeat(rgb[..., 1:2], 3, axis=2)
    raw = av.VideoFrame.from_ndarray(rgb, format="rgb24")
    raw = raw.reformat(format=coded, dst_colorspace=5, src_color_range=2, dst_color_range=2, interpolation=0x42010)
    target = resolve_format(coded, *SIZE, 6, 2)
    assert target.name == delivered
    frame = to_frame(raw, DecodingPlan(SIZE, coded, target, _upright()), 0, 0, Fraction(1, 25))
    assert [plane.shape for plane in frame.planes] == list(target.plane_shapes(*SIZE))
    # what chroma at a half or a quarter of the size costs this picture: 2.2 and 4.4 levels
    assert np.abs(frame.rgb().astype(int) - rgb).mean() < (5.0 if coded == "yuv411p" else 2.5)


@pytest.mark.parametrize("coded", ["rgb555le", "rgb555be", "rgb565le", "bgr565be"])
def test_white_of_five_bits_stays_white(coded: str) -> None:
    raw = av.VideoFrame(*SIZE, coded)
    raw.planes[0].update(b"\xff" * raw.planes[0].buffer_size)
    target = resolve_format(coded, *SIZE, 2, 0)
    frame = to_frame(raw, DecodingPlan(SIZE, coded, target, _upright()), 0, 0, Fraction(1, 25))
    assert [np.unique(plane).tolist() for plane in frame.planes] == [[255]] * 3


def test_uncoded_samples_beyond_the_depth_are_refused_with_their_frame(tmp_path: Path) -> None:
    path = tmp_path / "raw.mkv"
    with av.open(str(path), "w", options={"strict": "unofficial", "allow_raw_vfw": "1"}) as output:
        stream: Any = output.add_stream("rawvideo", rate=25)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p10le"
        stream.codec_context.codec_tag = "Y3\x0b\x0a"  # libav's own name of these planes
        for k in range(3):
            picture = libav_frame(colorful(5), "yuv420p10le")
            if k == 2:
                np.frombuffer(memoryview(picture.planes[1]), np.uint16)[-SIZE[0] // 2] = 1024  # type: ignore[arg-type]
            picture.pts, picture.time_base = k, Fraction(1, 25)
            output.mux(stream.encode(picture))
        output.mux(stream.encode(None))
    for start in (0, 1):
        frames = read_frames(path, start=start)
        assert [next(frames).index for _ in range(start, 2)] == list(range(start, 2))
        with pytest.raises(MediaError, match=r"raw.mkv has values beyond 10 bits in frame 2"):
            next(frames)


def _upright() -> Any:
    raw = av.VideoFrame(*SIZE, "yuv420p")

    class Context:
        name = "h264"
        color_range, colorspace, color_primaries, color_trc = 1, 1, 1, 1

    class Clip:
        name = "clip"
        stream = type("Stream", (), {"codec_context": Context})
        colors = StatedColors()

    clip: Any = Clip
    return decoding_plan(clip, raw).orientation


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
@pytest.mark.parametrize("hflip", [False, True])
def test_display_matrices_are_applied(degrees: int, hflip: bool, tmp_path: Path) -> None:
    raw = [libav_frame(colorful(k)) for k in range(3)]
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


@pytest.mark.parametrize(
    ("orientation", "turned"),
    [
        (1, lambda plane: plane),
        (4, lambda plane: plane[::-1]),
        (5, lambda plane: plane.T),
        (6, lambda plane: np.rot90(plane, -1)),
    ],
)
@pytest.mark.parametrize("suffix", [".avi", ".mov"])
def test_motion_jpeg_is_turned_by_the_exif_of_its_pictures(
    orientation: int, turned: Callable[[Any], Any], suffix: str, tmp_path: Path
) -> None:
    raw = [libav_frame(colorful(k), "yuvj420p") for k in range(3)]
    plain = encode_raw(tmp_path / f"plain{suffix}", raw, "mjpeg")
    exif = b"II*\0\x08\0\0\0\1\0" + struct.pack("<HHII", 0x0112, 3, 1, orientation) + bytes(4)
    path = tmp_path / f"camera{suffix}"
    with av.open(str(plain)) as source, av.open(str(path), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                coded = av.Packet(into_jpeg(bytes(packet), PictureMetadata(exif=exif)))
                coded.pts, coded.dts, coded.time_base = packet.pts, packet.dts, packet.time_base
                coded.duration, coded.is_keyframe, coded.stream = packet.duration, True, stream
                target.mux_one(coded)
    before, after = list(read_frames(plain)), list(read_frames(path))
    assert probe(path).frame_count == len(before) == len(after) == 3
    assert read_streams(path).embedded == ()
    for one, other in zip(before, after, strict=True):
        for stored, upright in zip(one.planes, other.planes, strict=True):
            np.testing.assert_array_equal(upright, turned(stored))


def test_columns_that_pictures_are_cropped_by_are_not_shown(tmp_path: Path) -> None:
    pictures = [libav_frame(np.roll(colorful(7), 3 * k, 1)) for k in range(4)]
    whole = encode_raw(tmp_path / "whole.mp4", pictures, "libx264")
    cropped = encode_raw(tmp_path / "cropped.mp4", pictures, "libx264", **{"x264-params": "crop-rect=6,2,10,4"})
    info = probe(cropped)
    assert (info.width, info.height) == (SIZE[0] - 16, SIZE[1] - 6)
    for frame, other in zip(read_frames(cropped), read_frames(whole), strict=True):
        for plane, uncropped, step in zip(frame.planes, other.planes, (1, 2, 2), strict=True):
            rows, columns = slice(2 // step, (SIZE[1] - 4) // step), slice(6 // step, (SIZE[0] - 10) // step)
            np.testing.assert_array_equal(plane, uncropped[rows, columns])


@pytest.mark.parametrize(
    ("degrees", "said"), [(7, "353.0 degrees and is turned by 0"), (-100, "100.0 degrees and is turned by 90")]
)
def test_a_turn_that_is_no_quarter_is_warned_of(degrees: int, said: str, tmp_path: Path) -> None:
    path = encode_raw(tmp_path / "o.mp4", [libav_frame(colorful(1))], "libx264", degrees=degrees)
    (warning,) = probe(path).warnings
    assert said in warning


def _coded(path: Path, codec: str, layout: str = "yuv420p", **options: str) -> Path:
    return encode_raw(path, [libav_frame(colorful(3, SIZE), layout)] * 3, codec, **options)


@pytest.mark.parametrize("codec", ["libx264", "libx265"])
def test_colors_that_the_container_alone_tells_are_read_and_kept(codec: str, tmp_path: Path) -> None:
    """A decoder of HEVC writes "not stated" over them."""
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    clip = color_container(_coded(tmp_path / "i.mp4", codec, **options), 9, 18, 9)
    info = probe(clip)
    assert (info.color, info.color_primaries, info.color_transfer, info.color_matrix) == ("HLG BT.2020", 9, 18, 9)
    assert info.format == next(read_frames(clip)).format
    assert info.format.luma_weights == LUMA_WEIGHTS[9]
    again = probe(write_clip(tmp_path / "o.mp4", list(read_frames(clip)), info))
    assert (again.color, again.color_matrix) == (info.color, 9)


def test_a_deep_clip_whose_container_tells_its_transfer_function_is_not_warned_of(tmp_path: Path) -> None:
    clip = _coded(tmp_path / "i.mp4", "libx265", "yuv420p10le", **{"x265-params": "log-level=none"})
    assert "transfer function" in "".join(probe(clip).warnings)
    assert not probe(color_container(clip, 1, 1, 1)).warnings


@pytest.mark.parametrize("matrix", [0, 3])
def test_a_matrix_that_no_luma_and_chroma_have_is_not_stated(matrix: int, tmp_path: Path) -> None:
    clip = color_container(_coded(tmp_path / "i.mp4", "libx264"), 1, 1, matrix)
    info = probe(clip)
    assert (info.color_matrix, info.format.luma_weights) == (2, LUMA_WEIGHTS[6])
    again = probe(write_clip(tmp_path / "o.mp4", list(read_frames(clip)), info))
    assert (again.color_primaries, again.color_matrix) == (1, 2)


@pytest.mark.parametrize("stated", [0, 1])
def test_prores_whose_pictures_do_not_know_their_matrix_has_the_containers(stated: int, tmp_path: Path) -> None:
    clip = _coded(tmp_path / "i.mov", "prores_ks", "yuv422p10le")
    data, at = bytearray(clip.read_bytes()), -1
    while (at := data.find(b"icpf", at + 1)) >= 0:
        data[at + 18 : at + 21] = bytes(3)  # primaries, transfer, matrix: "unknown" (SMPTE RDD 36)
    clip.write_bytes(data)
    if stated:
        color_container(clip, 1, 1, 1)
    info = probe(clip)
    assert info.color_matrix == (1 if stated else 2)
    assert info.format.luma_weights == LUMA_WEIGHTS[1 if stated else 6]
    again = probe(write_clip(tmp_path / "o.mp4", list(read_frames(clip)), info))
    assert again.color_matrix == info.color_matrix


@pytest.mark.parametrize("said", [True, False])
@pytest.mark.parametrize("matrix", [1, 9, 6])
def test_dnxhr_has_the_matrix_of_its_clip_in_its_pictures_too(matrix: int, said: bool, tmp_path: Path) -> None:
    """Encoders that do not write it say BT.709 there; the container knows better."""
    fmt = pixel_format("yuv422p10le", matrix)
    info = media_info(fmt, (256, 128), color_matrix=matrix, color_primaries=matrix, color_transfer=matrix % 8)
    path = write_clip(tmp_path / "o.mov", smooth_frames(2, fmt, (256, 128)), info, codec="dnxhr")
    with av.open(str(path)) as clip:
        assert [picture.colorspace for picture in clip.decode(video=0)] == [matrix, matrix]
    with av.open(str(path)) as clip:
        places = [packet.pos for packet in clip.demux(video=0) if packet.pos is not None]
    if not said:
        data = bytearray(path.read_bytes())
        for place in places:
            data[place + 0x2C] &= ~6
        path.write_bytes(bytes(data))
    assert probe(path).color_matrix == matrix
    assert next(read_frames(path)).format.luma_weights == LUMA_WEIGHTS[matrix]


@pytest.mark.parametrize("matrix", [2, 6])
def test_dnxhr_says_the_matrix_that_a_clip_without_tags_was_read_by(matrix: int, tmp_path: Path) -> None:
    """Small pictures are BT.601's; DNxHR's without a matrix are taken for BT.709."""
    tags = {"x264-params": f"colormatrix={'smpte170m' if matrix == 6 else 'undef'}"}
    clip = encode_raw(tmp_path / "i.mp4", [libav_frame(colorful(2, (256, 128)))] * 2, "libx264", **tags)
    info = probe(clip)
    assert (info.color_primaries, info.color_matrix, info.format.luma_weights) == (2, matrix, LUMA_WEIGHTS[6])
    path = write_clip(tmp_path / "o.mov", list(read_frames(clip)), info, codec="dnxhr")
    with av.open(str(path)) as written:
        assert next(written.decode(video=0)).colorspace == 6
    assert next(read_frames(path)).format.luma_weights == LUMA_WEIGHTS[6]
    told = [make_plan(info, container="mov", codec=codec).changed for codec in ("dnxhr", "prores")]
    assert [any("BT.601" in line for line in lines) for lines in told] == [True, False]


def test_a_sideways_422_clip_becomes_444(tmp_path: Path) -> None:
    raw = [libav_frame(colorful(2), "yuv422p") for _ in range(2)]
    plain = next(read_frames(encode_raw(tmp_path / "plain.mp4", raw, "libx264", crf="0")))
    turned = next(read_frames(encode_raw(tmp_path / "turned.mp4", raw, "libx264", degrees=90, crf="0")))
    assert turned.format.name == "yuv444p"
    np.testing.assert_array_equal(turned.planes[0], np.rot90(plain.planes[0]))
    assert np.abs(turned.rgb().astype(int) - np.rot90(plain.rgb())).mean() < 1.0


def test_matrix_and_range_tags_give_the_same_picture(media_dir: Path) -> None:
    """The same pixels coded four ways decode to about the same RGB, and any other reading of them is worse.

    Coding alone costs these files 0.9 to 2.3 levels; a wrong matrix or range costs 3.8 to 7.2.
    """
    names = ("bt601_full_range", "bt601_limited_range", "bt709_full_range", "bt709_limited_range")
    frames = [next(read_frames(media_dir / "odd" / f"{name}.mp4")) for name in names]
    first = frames[0].rgb().astype(float)
    for frame in frames:
        readings = [np.clip(other.format.to_rgb(frame.planes), 0, 255) for other in frames]
        errors = {other.format: np.abs(rgb - first).mean() for other, rgb in zip(frames, readings, strict=True)}
        assert errors.pop(frame.format) < 2.5
        assert min(errors.values()) > 3.5
        assert np.abs(frame.rgb() - first).mean() < 2.5


def test_a_sideways_clip_is_upright(media_dir: Path) -> None:
    info = probe(media_dir / "odd" / "rotated90_display_matrix.mp4")
    assert info.rotation in (90, 270)
    frame = next(read_frames(media_dir / "odd" / "rotated90_display_matrix.mp4"))
    assert (frame.width, frame.height) == (info.width, info.height)
    sky = cv2.resize(frame.rgb(), (8, 8), interpolation=cv2.INTER_AREA)
    assert sky.shape == (8, 8, 3)
