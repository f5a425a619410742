from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import (
    PictureMetadata,
    lost_in_picture,
    png,
    probe,
    read_image,
    read_picture_metadata,
    write_image,
)
from pvg.video.exif import ORIENTATION, read_exif
from pvg.video.ifd import HEADER, Block, Directory, Entry, longs, opaque, shorts, written
from tests.gallery import hostile, profiles

ALL = [".png", ".tiff", ".jpg", ".webp"]


def profile(space: bytes = b"RGB ", size: int = 200_000) -> bytes:
    """Bytes with the header of an ICC profile, longer than a JPEG segment."""
    body = np.random.default_rng(3).integers(0, 256, size, dtype=np.uint8).tobytes()
    return struct.pack(">I", size) + body[4:16] + space + body[20:36] + b"acsp" + body[40:]


def camera_exif(orientation: int = 1) -> bytes:
    """An EXIF block as a phone writes it: a place, a thumbnail, a maker's note and what is worth keeping."""
    main: Directory = {
        0x010F: Entry(2, 6, b"Maker\0"),
        ORIENTATION: shorts(orientation),
        0x0132: Entry(2, 20, b"2024:01:02 03:04:05\0"),
    }
    details: Directory = {
        0x829A: Entry(5, 1, struct.pack("<II", 1, 125)),
        0x927C: opaque(b"maker's secret and a PREVIEW" * 4),
        0xA002: longs([7]),
        0xA003: longs([5]),
    }
    gps: Directory = {0x0002: Entry(5, 3, struct.pack("<6I", 48, 1, 51, 1, 30, 1)), 0x001B: opaque(b"PLACE NAME")}
    block = bytearray(HEADER + struct.pack("<I", 8) + written(main, {0x8769: details, 0x8825: gps}, 8))
    thumbnail = len(block)
    struct.pack_into("<I", block, 10 + 12 * (len(main) + 2), thumbnail)
    return bytes(block) + written({0x0201: longs([thumbnail + 30])}, {}, thumbnail) + b"\xff\xd8THUMBNAIL\xff\xd9"


def noise(depth: int, channels: int = 3, size: tuple[int, int] = (7, 5)) -> Any:
    dtype = np.uint8 if depth == 8 else np.uint16
    return np.random.default_rng(depth).integers(0, 2**depth, (size[1], size[0], channels), dtype=dtype)


def smooth(depth: int = 8) -> Any:
    y, x = np.mgrid[:32, :48]
    rgb = np.stack([x * 4, y * 5, 128 + x], axis=-1)
    return (rgb * (257 if depth == 16 else 1)).astype(np.uint16 if depth == 16 else np.uint8)


def test_the_resolution_of_a_jpeg_is_kept_in_jpeg_and_its_loss_is_said(tmp_path: Path) -> None:
    plain, source = tmp_path / "plain.jpg", tmp_path / "dense.jpg"
    write_image(plain, smooth())
    data = bytearray(plain.read_bytes())
    assert data[6:11] == b"JFIF\0"
    data[13:18] = b"\1\x01\x2c\x01\x2c"  # 300 dots an inch
    source.write_bytes(data)
    write_image(tmp_path / "again.jpg", smooth(), metadata=read_picture_metadata(source))
    assert (tmp_path / "again.jpg").read_bytes()[:20] == bytes(data[:20])
    assert not lost_in_picture(source, "again.jpg")
    assert any("resolution" in line for line in lost_in_picture(source, "a.png"))
    assert not lost_in_picture(plain, "a.png")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff"])
@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("has_alpha", [False, True])
def test_png_and_tiff_keep_every_bit(suffix: str, depth: int, has_alpha: bool, tmp_path: Path) -> None:
    samples = noise(depth, 4, (301, 1201))  # several strips
    path = tmp_path / f"picture{suffix}"
    write_image(path, samples[..., :3], alpha=samples[..., 3] if has_alpha else None)
    frame, info = read_image(path), probe(path)
    np.testing.assert_array_equal(np.stack(frame.planes, axis=-1), samples[..., :3])
    assert frame.format.depth == info.format.depth == depth
    assert info.has_alpha is has_alpha
    if has_alpha:
        np.testing.assert_array_equal(frame.alpha, samples[..., 3])
    else:
        assert frame.alpha is None
    shown = frame.rgb().astype(int)
    assert np.abs(shown - samples[..., :3] / (257 if depth == 16 else 1)).max() <= 0.5


def test_alpha_of_webp_is_kept_and_that_of_jpeg_is_left_out(tmp_path: Path) -> None:
    alpha = np.tile(np.arange(48, dtype=np.uint8) * 5, (32, 1))
    write_image(tmp_path / "a.webp", smooth(), alpha=alpha)
    write_image(tmp_path / "a.jpg", smooth(), alpha=alpha)
    np.testing.assert_array_equal(read_image(tmp_path / "a.webp").alpha, alpha)
    assert read_image(tmp_path / "a.jpg").alpha is None
    assert any("transparency" in line for line in lost_in_picture(tmp_path / "a.webp", "b.jpg"))
    assert not lost_in_picture(tmp_path / "a.webp", "b.png")


def test_sixteen_bits_become_the_nearest_eight_where_there_is_no_room(tmp_path: Path) -> None:
    write_image(tmp_path / "deep.png", smooth(16))
    for suffix in (".jpg", ".webp"):
        write_image(tmp_path / f"flat{suffix}", smooth(16))
        frame = read_image(tmp_path / f"flat{suffix}")
        assert frame.format.depth == 8
        assert np.abs(frame.rgb().astype(int) - smooth()).mean() < 3
        assert any("8 bits" in line for line in lost_in_picture(tmp_path / "deep.png", f"out{suffix}"))
    assert not lost_in_picture(tmp_path / "deep.png", "out.tiff")


@pytest.mark.parametrize("source", ALL)
@pytest.mark.parametrize("target", ALL)
def test_profile_and_exif_go_from_any_picture_to_any_other(source: str, target: str, tmp_path: Path) -> None:
    first, second = tmp_path / f"first{source}", tmp_path / f"second{target}"
    write_image(first, smooth(), metadata=PictureMetadata(icc=profile(), exif=read_exif(camera_exif()).block()))
    found = read_picture_metadata(first)
    write_image(second, np.stack(read_image(first).planes, axis=-1), metadata=found)
    again = read_picture_metadata(second)
    assert found.icc == again.icc == profile()
    assert not found.lost
    assert not lost_in_picture(first, second)
    for block in (found.exif, again.exif):
        assert block is not None
        exif = read_exif(block)
        assert exif.main[0x010F].body == b"Maker\0"
        assert exif.details[0x829A].body == struct.pack("<II", 1, 125)
    assert np.abs(read_image(second).rgb().astype(int) - smooth()).mean() < 4


def test_place_thumbnail_and_makers_note_are_left_out_byte_by_byte(tmp_path: Path) -> None:
    data = cv2.imencode(".jpg", smooth())[1].tobytes()
    segment = b"Exif\0\0" + camera_exif(6)
    path = tmp_path / "phone.jpg"
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:])
    found = read_picture_metadata(path)
    assert found.orientation == 6
    assert set(found.lost) == {"location", "thumbnail", "maker's note"}
    assert len([line for line in lost_in_picture(path, "out.png") if "is not kept" in line]) == 3
    for suffix in ALL:
        out = tmp_path / f"out{suffix}"
        frame = read_image(path)
        assert (frame.width, frame.height) == (32, 48)
        write_image(out, np.stack(frame.planes, axis=-1), metadata=found)
        body = out.read_bytes()
        assert not any(secret in body for secret in (b"PLACE", b"THUMB", b"PREVIEW"))
        again = read_picture_metadata(out)
        assert again.orientation == 1
        assert again.exif is not None
        exif = read_exif(again.exif)
        assert exif.details[0xA002].numbers() == (5,)  # sideways: width and height are exchanged
        assert (read_image(out).width, read_image(out).height) == (32, 48)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ALL)
def test_every_picture_is_turned_as_its_exif_says(orientation: int, suffix: str, tmp_path: Path) -> None:
    turned = {
        1: lambda a: a,
        2: lambda a: a[:, ::-1],
        3: lambda a: np.rot90(a, 2),
        4: lambda a: a[::-1],
        5: lambda a: a.swapaxes(0, 1),
        6: lambda a: np.rot90(a, -1),
        7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
        8: lambda a: np.rot90(a, 1),
    }
    path = tmp_path / f"turned{suffix}"
    exif = HEADER + struct.pack("<I", 8) + written({ORIENTATION: shorts(orientation)}, {}, 8)
    write_image(path, smooth(), metadata=PictureMetadata(exif=exif))
    if suffix == ".tiff":
        data = bytearray(path.read_bytes())
        at = Block(bytes(data)).place_of(Block(bytes(data)).first, ORIENTATION)
        assert at is not None
        struct.pack_into("<H", data, at, orientation)
        path.write_bytes(bytes(data))
    expected = turned[orientation](smooth()).astype(int)
    assert np.abs(read_image(path).rgb() - expected).mean() < 4


def test_chunks_of_colour_stay_in_png_and_are_named_elsewhere(tmp_path: Path) -> None:
    shown = ((b"gAMA", struct.pack(">I", 45455)),)
    write_image(tmp_path / "a.png", smooth(), metadata=PictureMetadata(png=shown))
    assert read_picture_metadata(tmp_path / "a.png").png == shown
    assert not lost_in_picture(tmp_path / "a.png", "b.png")
    assert any("gAMA" in line for line in lost_in_picture(tmp_path / "a.png", "b.tiff"))


def test_what_no_picture_keeps_is_named(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", smooth(), metadata=PictureMetadata(icc=profile(b"GRAY")))
    assert read_picture_metadata(tmp_path / "a.png").icc is None  # a profile for grey does not fit RGB
    data = (tmp_path / "a.png").read_bytes()
    text = b"tEXtComment\0hello"
    grey = b"iCCPgrey\0\0" + zlib.compress(profile(b"GRAY"))
    chunks = b"".join(
        struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body)) for body in (text, grey)
    )
    (tmp_path / "b.png").write_bytes(data[:33] + chunks + data[33:])
    lines = lost_in_picture(tmp_path / "b.png", "c.png")
    assert any("text" in line for line in lines)
    assert any("not for RGB" in line for line in lines)
    assert all("\n" not in line for line in lines)


@pytest.mark.parametrize("cut", range(8, 120, 7))
def test_a_damaged_exif_block_is_left_out_and_named(cut: int, tmp_path: Path) -> None:
    path = tmp_path / "a.webp"
    write_image(path, smooth(), metadata=PictureMetadata(exif=camera_exif()[:cut]))
    found = read_picture_metadata(path)
    assert found.exif is None
    assert found.lost == ("a damaged EXIF block",)
    assert read_image(path).width == 48


# TIFF of other makers


def tiff_of(samples: Any, order: str = "<", **tags: Any) -> bytes:
    """An uncompressed TIFF; tags by number as t259=…, None leaves one out."""
    height, width, count = samples.shape
    data = samples.astype(samples.dtype.newbyteorder(order)).tobytes()
    bits = samples.dtype.itemsize * 8
    fields: dict[int, Any] = {256: [width], 257: [height], 258: [bits] * count, 259: [1], 262: [2 if count > 2 else 1]}
    fields |= {273: [0], 277: [count], 278: [height], 279: [len(data)], 284: [1]}
    fields |= {int(name[1:]): value for name, value in tags.items()}
    fields = {tag: value for tag, value in sorted(fields.items()) if value is not None}
    after = 8 + 2 + 12 * len(fields) + 4
    wide = sum(4 * len(value) for value in fields.values() if len(value) > 1)
    fields[273] = [after + wide]
    out, tail = b"", b""
    for tag, value in fields.items():
        raw = struct.pack(f"{order}{len(value)}I", *value)
        out += struct.pack(order + "HHI", tag, 4, len(value))
        out += raw if len(raw) <= 4 else struct.pack(order + "I", after + len(tail))
        tail += raw if len(raw) > 4 else b""
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "IH", 8, len(fields))
    return head + out + b"\0\0\0\0" + tail + data


def test_the_records_of_photoshop_in_a_tiff_are_left_out_byte_by_byte(tmp_path: Path) -> None:
    """Its document data hold the layers as they were, its resources a preview, IPTC a place."""
    data = bytearray(tiff_of(smooth()))
    directory, _ = Block(bytes(data)).directory(8)
    secrets = {33723: b"PLACE IN IPTC", 34377: b"8BIM THUMB", 37724: b"Adobe Photoshop Document Data Block\0LAYERS"}
    directory |= {tag: opaque(body) for tag, body in secrets.items()}
    struct.pack_into("<I", data, 4, len(data))
    path = tmp_path / "layered.tif"
    path.write_bytes(bytes(data) + written(directory, {}, len(data)))
    found = read_picture_metadata(path)
    assert set(found.lost) == {"IPTC", "Photoshop's layers and resources"}
    for suffix in ALL:
        out = tmp_path / f"out{suffix}"
        assert len(lost_in_picture(path, out)) == 2
        write_image(out, smooth(), metadata=found)
        body = out.read_bytes()
        assert not any(secret in body for secret in (b"PLACE", b"THUMB", b"LAYERS"))
        assert not read_picture_metadata(out).lost


@pytest.mark.parametrize("tag", [33723, 34377, 37724])
def test_records_of_other_programs_in_an_exif_block_are_left_out_and_named(tag: int) -> None:
    block = HEADER + struct.pack("<I", 8) + written({0x010F: Entry(2, 6, b"Maker\0"), tag: opaque(b"SECRET")}, {}, 8)
    exif = read_exif(block)
    assert set(exif.main) == {0x010F}
    assert len(exif.lost) == 1


def planar_tiff_of(samples: Any, order: str) -> bytes:
    """The same with a strip for each sample of a pixel (PlanarConfiguration 2)."""
    height, width, count = samples.shape
    data = bytearray(tiff_of(samples, order, t284=[2], t338=[2] if count in (2, 4) else None))
    size = width * height * samples.dtype.itemsize
    start = len(data) - size * count
    data[start:] = np.moveaxis(samples, -1, 0).astype(samples.dtype.newbyteorder(order)).tobytes()
    (fields,) = struct.unpack_from(order + "H", data, 8)
    for k in range(fields):
        tag, kind, _, _ = struct.unpack_from(order + "HHII", data, 10 + 12 * k)
        for wanted, values in ((273, [start + size * n for n in range(count)]), (279, [size] * count)):
            if tag == wanted:
                struct.pack_into(
                    order + "HHII", data, 10 + 12 * k, tag, kind, count, values[0] if count == 1 else len(data)
                )
                data += struct.pack(f"{order}{count}I", *values) if count > 1 else b""
    return bytes(data)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_grey_and_rgb_tiffs_of_both_byte_orders_are_read_bit_for_bit(
    order: str, depth: int, count: int, tmp_path: Path
) -> None:
    samples = noise(depth, count)
    path = tmp_path / "a.tif"
    path.write_bytes(tiff_of(samples, order, t338=[2] if count in (2, 4) else None))
    frame = read_image(path)
    colors = samples[..., :3] if count > 2 else samples[..., [0, 0, 0]]
    np.testing.assert_array_equal(np.stack(frame.planes, axis=-1), colors)
    assert (frame.alpha is None) is (count in (1, 3))
    if frame.alpha is not None:
        np.testing.assert_array_equal(frame.alpha, samples[..., -1])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("count", [1, 3, 4])
def test_tiffs_with_a_plane_for_each_sample_are_read_bit_for_bit(
    order: str, depth: int, count: int, tmp_path: Path
) -> None:
    samples = noise(depth, count)
    path = tmp_path / "a.tif"
    path.write_bytes(planar_tiff_of(samples, order))
    frame = read_image(path)
    colors = samples[..., :3] if count > 2 else samples[..., [0, 0, 0]]
    np.testing.assert_array_equal(np.stack(frame.planes, axis=-1), colors)
    assert (frame.alpha is None) is (count < 4)
    if frame.alpha is not None:
        np.testing.assert_array_equal(frame.alpha, samples[..., -1])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("depth", [8, 16])
def test_a_grey_tiff_whose_zero_is_white_is_no_negative(order: str, depth: int, tmp_path: Path) -> None:
    samples = noise(depth, 1)
    path = tmp_path / "a.tif"
    path.write_bytes(tiff_of(samples, order, t262=[0]))
    frame = read_image(path)
    assert frame.format.depth == depth
    np.testing.assert_array_equal(frame.planes[0], 2**depth - 1 - samples[..., 0])


def test_a_deep_tiff_in_tiles_and_planes_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tiles = {"t322": [16], "t323": [16], "t324": [8, 8, 8], "t325": [9, 9, 9]}
    path.write_bytes(tiff_of(noise(16), t284=[2], **tiles))
    with pytest.raises(MediaError, match="16 bits in tiles and planes"):
        read_image(path)


def test_premultiplied_colours_are_divided_by_their_alpha(tmp_path: Path) -> None:
    straight = noise(16, 4)
    straight[..., 3] |= 0x8000
    stored = straight.copy()
    stored[..., :3] = np.rint(straight[..., :3] * (straight[..., 3:] / 65535.0))
    path = tmp_path / "a.tif"
    path.write_bytes(tiff_of(stored, t338=[1]))
    frame = read_image(path)
    assert np.abs(np.stack(frame.planes, axis=-1).astype(int) - straight[..., :3]).max() <= 2
    assert any("premultiplied" in line for line in lost_in_picture(path, "b.tiff"))


@pytest.mark.parametrize(
    ("tags", "says"),
    [
        ({"t262": [5]}, "CMYK"),
        ({"t339": [3]}, "floating-point"),
        ({"t258": [4, 4, 4]}, "4-bit"),
        ({"t254": [1]}, "raw"),
        ({"t279": [10**6]}, "cut short"),
        ({"t256": [30000], "t257": [30000]}, "30000x30000"),
        ({"t256": [0]}, "no size"),
    ],
)
def test_tiffs_that_are_not_read_are_refused_in_one_line(tags: dict[str, Any], says: str, tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(tiff_of(noise(8), **tags))
    for read in (probe, read_image):
        with pytest.raises(MediaError, match=says) as caught:
            read(path)
        assert "\n" not in str(caught.value)


def test_big_tiff_and_several_pages_are_refused_by_name(tmp_path: Path) -> None:
    big = tmp_path / "big.tif"
    big.write_bytes(b"II+\0\x08\0\0\0" + b"\0" * 64)
    with pytest.raises(MediaError, match="BigTIFF"):
        probe(big)
    pages = bytearray(tiff_of(noise(8)))
    struct.pack_into("<I", pages, 10 + 12 * 10, len(pages))
    pages += written({256: longs([7])}, {}, len(pages))
    (tmp_path / "pages.tif").write_bytes(bytes(pages))
    with pytest.raises(MediaError, match="several pages"):
        probe(tmp_path / "pages.tif")
    loop = bytearray(tiff_of(noise(8)))
    struct.pack_into("<I", loop, 10 + 12 * 10, 8)
    (tmp_path / "loop.tif").write_bytes(bytes(loop))
    with pytest.raises(MediaError, match="several pages"):
        probe(tmp_path / "loop.tif")


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_tiff_gives_a_picture_or_one_line(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    write_image(tmp_path / "a.tif", noise(16), metadata=PictureMetadata(icc=profile(size=300), exif=camera_exif()))
    data = np.frombuffer((tmp_path / "a.tif").read_bytes(), np.uint8).copy()
    data[rng.integers(4, len(data), 6)] = rng.integers(0, 256, 6)
    path = tmp_path / "b.tif"
    path.write_bytes(data.tobytes()[: len(data) - int(rng.integers(0, 40))])
    try:
        assert read_image(path).width >= 1
    except MediaError as error:
        assert "\n" not in str(error)  # noqa: PT017 - either outcome is right


@pytest.mark.parametrize("layout", ["rgb24", "rgb48le", "rgba", "gray"])
def test_our_tiffs_are_those_of_others(layout: str, tmp_path: Path) -> None:
    """Another reader, libtiff by way of OpenCV, sees the same samples; libav's own TIFFs are read."""
    depth = 16 if "48" in layout else 8
    rgb = noise(depth, 3, (40, 30))
    write_image(tmp_path / "ours.tiff", rgb)
    theirs = cv2.imread(str(tmp_path / "ours.tiff"), cv2.IMREAD_UNCHANGED)
    assert theirs is not None
    np.testing.assert_array_equal(theirs[..., ::-1], rgb)
    picture = av.VideoFrame.from_ndarray(noise(8, 3, (40, 30)), format="rgb24").reformat(format=layout)
    context: Any = av.CodecContext.create("tiff", "w")
    context.width, context.height, context.pix_fmt, context.time_base = 40, 30, layout, 1
    (tmp_path / "theirs.tiff").write_bytes(b"".join(bytes(p) for p in [*context.encode(picture), *context.encode()]))
    assert read_image(tmp_path / "theirs.tiff").width == 40


def png_of(samples: Any, color: int, bits: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """A PNG of a colour type: 0 grey, 2 RGB, 3 palette, 4 grey and alpha."""
    packed = samples.astype(">u2" if bits == 16 else np.uint8)
    rows = b"".join(b"\0" + row.tobytes() for row in packed)
    header = struct.pack(">IIBBBBB", samples.shape[1], samples.shape[0], bits, color, 0, 0, 0)
    parts = [(b"IHDR", header), *chunks, (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in parts
    )


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("color", [0, 2, 3, 4])
def test_every_way_of_transparency_in_png_becomes_alpha(color: int, bits: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(color)
    if color == 3:
        bits = 8
    count = {0: 1, 2: 3, 3: 1, 4: 2}[color]
    samples = rng.integers(0, 4 if color == 3 else 2**bits, (6, 8, count))
    key = struct.pack(f">{count}H", *samples[2, 3])
    chunks = {
        0: [(b"tRNS", key)],
        2: [(b"tRNS", key)],
        3: [(b"PLTE", bytes(range(12))), (b"tRNS", bytes([9, 99]))],
        4: [],
    }[color]
    path = tmp_path / "a.png"
    path.write_bytes(png_of(samples, color, bits, *chunks))
    frame = read_image(path)
    assert frame.alpha is not None
    assert read_picture_metadata(path).has_alpha
    top = 2**bits - 1
    keyed = np.where((samples == samples[2, 3]).all(axis=2), 0, top)
    expected = {0: keyed, 2: keyed, 3: np.array([9, 99, 255, 255])[samples[..., 0] % 4], 4: samples[..., -1]}[color]
    np.testing.assert_array_equal(frame.alpha, expected)


def test_an_exif_block_whose_values_share_their_bytes_is_refused() -> None:
    tags = b"".join(struct.pack("<HHII", 0x9000 + k, 7, 60_000, 8) for k in range(300))
    block = HEADER + struct.pack("<IH", 8, 300) + tags + bytes(60_000)
    with pytest.raises(ValueError, match="more than"):
        read_exif(block)


@pytest.mark.parametrize("suffix", ALL)
@pytest.mark.parametrize("seed", range(25))
def test_damaged_metadata_gives_a_picture_or_one_line(suffix: str, seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path / f"a{suffix}"
    write_image(path, smooth(), metadata=PictureMetadata(icc=profile(size=300), exif=camera_exif()))
    data = np.frombuffer(path.read_bytes(), np.uint8).copy()
    places = rng.integers(3, min(len(data), 1200), 8)
    data[places] = rng.integers(0, 256, 8)
    path.write_bytes(data.tobytes())
    for read in (read_image, read_picture_metadata, lambda p: lost_in_picture(p, "out.png")):
        try:
            read(path)
        except MediaError as error:
            assert "\n" not in str(error)  # noqa: PT017 - either outcome is right


def test_of_many_profiles_in_a_png_the_first_alone_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = hostile.many_profiles(tmp_path)
    read = list[bytes]()
    inflated = png._inflated
    monkeypatch.setattr(png, "_inflated", lambda body: read.append(body) or inflated(body))
    assert read_picture_metadata(path).icc == profiles.profile(profiles.P3, profiles.gamma_curve(1.8))
    assert len(read) == 1


@pytest.mark.parametrize("make", [hostile.many_chunks, hostile.many_chunks_of_webp, hostile.many_segments])
def test_pictures_of_many_parts_are_refused_before_their_samples(make: Callable[[Path], Path], tmp_path: Path) -> None:
    with pytest.raises(MediaError, match="more than 100000"):
        read_picture_metadata(make(tmp_path))


@pytest.mark.parametrize(("components", "lost"), [(1, ()), (3, ()), (4, ("coding in four inks (CMYK)",))])
def test_a_jpeg_of_four_inks_is_said_to_lose_them(components: int, lost: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "inks.jpg"
    header = struct.pack(">BHHB", 8, 64, 96, components) + bytes(3 * components)
    path.write_bytes(b"\xff\xd8\xff\xc0" + struct.pack(">H", len(header) + 2) + header + b"\xff\xd9")
    assert read_picture_metadata(path).lost == lost
