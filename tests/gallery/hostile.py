"""Small files whose headers ask for much: indexes, scans and lists that a reader would build in memory or work through.

Each is an honest clip or picture made on the spot, changed in one place.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np

from tests.gallery.clips import libav_frame
from tests.gallery.pictures import colorful
from tests.gallery.profiles import P3, gamma_curve, profile

MANY = 80_000_000


def honest_clip(path: Path, **options: str) -> bytes:
    """A clip of 12 frames, 96x64, in the container of its suffix; options: the muxer's."""
    base = colorful(3)
    return _encoded(path, [np.roll(base, k, 1) for k in range(12)], options)


def _encoded(path: Path, pictures: list[np.ndarray], options: dict[str, str]) -> bytes:
    with av.open(str(path), "w", options=options) as output:
        stream = output.add_stream("mpeg4" if path.suffix == ".avi" else "libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for picture in pictures:
            output.mux(stream.encode(libav_frame(picture)))
        output.mux(stream.encode(None))
    return path.read_bytes()


# --- MP4 ------------------------------------------------------------------------------------------------------


def box(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I4s", len(body) + 8, kind) + body


def _refilled(data: bytes, kind: bytes, body: bytes) -> bytes:
    """The first box of a kind with another body of at most its own length, a free box after it."""
    at = data.index(kind) - 4
    size = struct.unpack_from(">I", data, at)[0]
    new = box(kind, body)
    rest = size - len(new)
    assert rest == 0 or rest >= 8, (size, len(new))
    return data[:at] + new + (box(b"free", bytes(rest - 8)) if rest else b"") + data[at + size :]


def many_samples(folder: Path) -> Path:
    """Its table of sizes says that 80 million samples of one byte follow each other."""
    path = folder / "many_samples.mp4"
    data = honest_clip(path)
    data = _refilled(data, b"stsz", struct.pack(">III", 0, 1, MANY))
    data = _refilled(data, b"stts", struct.pack(">IIII", 0, 1, MANY, 1))
    data = _refilled(data, b"stsc", struct.pack(">IIIII", 0, 1, 1, MANY, 1))
    path.write_bytes(data)
    return path


def misplaced_samples(folder: Path) -> Path:
    """The same, with the table where none belongs: in the user data of the track, which demuxers read all the same."""
    path = folder / "misplaced.mp4"
    data = many_samples(folder).read_bytes()
    at = data.index(b"minf") - 4
    size = struct.unpack_from(">I", data, at)[0]
    wrapped = box(b"edts", data[at : at + size])  # one more folder around the tables
    for outer in (b"mdia", b"trak", b"moov"):
        start = data.index(outer) - 4
        data = data[:start] + struct.pack(">I", struct.unpack_from(">I", data, start)[0] + 8) + data[start + 4 :]
    path.write_bytes(data[:at] + wrapped + data[at + size :])
    return path


def many_samples_of_sound(folder: Path) -> Path:
    """A sound track of 80 million samples, each in the index."""
    path = folder / "sound.mp4"
    path.write_bytes(_of_kind(many_samples(folder), b"soun"))
    return path


def _of_kind(clip: Path, kind: bytes) -> bytes:
    """The clip with its track said to be of another kind."""
    return clip.read_bytes().replace(b"vide", kind, 1)


def many_samples_in_a_fragment(folder: Path) -> Path:
    """A fragment that says the same of itself."""
    path = folder / "fragment.mp4"
    data = honest_clip(path, movflags="frag_keyframe+empty_moov+default_base_moof")
    path.write_bytes(_refilled(data, b"trun", struct.pack(">III", 1, MANY, 0)))
    return path


def compressed_index(folder: Path) -> Path:
    """QuickTime's compressed index, which grows a thousandfold."""
    path = folder / "cmov.mov"
    data = honest_clip(path)
    at = data.index(b"moov") - 4
    size = struct.unpack_from(">I", data, at)[0]
    packed = zlib.compress(data[at : at + size] + box(b"free", bytes(1_000_000)), 9)
    dcom, cmvd = box(b"dcom", b"zlib"), box(b"cmvd", struct.pack(">I", size + 1_000_008) + packed)
    path.write_bytes(data[:at] + box(b"moov", box(b"cmov", dcom + cmvd)) + data[at + size :])
    return path


def compressed_index_aside(folder: Path) -> Path:
    """The same, behind another box."""
    path = folder / "cmov_aside.mov"
    data = compressed_index(folder).read_bytes()
    at = data.index(b"moov") - 4
    size = struct.unpack_from(">I", data, at)[0]
    path.write_bytes(data[:at] + box(b"moov", box(b"free", b"") + data[at + 8 : at + size]) + data[at + size :])
    return path


def many_samples_of_text(folder: Path) -> Path:
    """A track of text whose handler has a name that begins as that of sound does."""
    path = folder / "text.mp4"
    path.write_bytes(_of_kind(many_samples(folder), b"text").replace(b"VideoHandler", b"sounoHandler", 1))
    return path


def index_beyond_all_files(folder: Path) -> Path:
    """An index of indexes that names a place where no file system has any."""
    path = folder / "beyond.avi"
    data = honest_clip(path)
    at = data.index(b"movi") - 8
    indx = struct.pack("<4sIHBBI4sQI", b"indx", 24 + 16, 4, 0, 0, 1, b"00dc", 0, 0) + struct.pack("<QII", 2**61, 8, 0)
    riff = struct.pack("<I", struct.unpack_from("<I", data, 4)[0] + len(indx))
    path.write_bytes(data[:4] + riff + data[8:at] + indx + data[at:])
    return path


def nested_boxes(folder: Path) -> Path:
    """Boxes in boxes, 100,000 deep."""
    path = folder / "nested.mp4"
    data = honest_clip(path)
    depth = 100_000
    inner = b"".join(struct.pack(">I4s", 8 * k, b"minf") for k in range(depth, 0, -1))
    at = data.index(b"moov") - 4
    path.write_bytes(data[:at] + box(b"moov", inner) + data[at:])
    return path


def many_boxes(folder: Path) -> Path:
    """An index of 200,000 empty boxes."""
    path = folder / "boxes.mp4"
    data = honest_clip(path)
    path.write_bytes(data[: data.index(b"moov") - 4] + box(b"moov", box(b"free", b"") * 200_000))
    return path


# --- Matroska, AVI --------------------------------------------------------------------------------------------


def _element(identity: int, body: bytes) -> bytes:
    return identity.to_bytes((identity.bit_length() + 7) // 8, "big") + (len(body) | 1 << 56).to_bytes(8, "big") + body


def _matroska(path: Path, header: bytes) -> Path:
    """An honest file with one more element before its tracks."""
    data = honest_clip(path)
    at = data.index(b"\x16\x54\xae\x6b", data.index(b"\x15\x49\xa9\x66") + 100)  # past the seek head and Info
    segment = data.index(b"\x18\x53\x80\x67") + 4
    data = data[:segment] + b"\x01" + b"\xff" * 7 + data[segment + 8 : at] + header + data[at:]
    path.write_bytes(data)
    return path


def many_tracks(folder: Path) -> Path:
    """Two million empty tracks in 4 MB."""
    return _matroska(folder / "tracks.mkv", _element(0x1654AE6B, b"\xae\x80" * 2_000_000))


def many_cues(folder: Path) -> Path:
    """Two million cue points."""
    return _matroska(folder / "cues.mkv", _element(0x1C53BB6B, b"\xbb\x82\xb7\x80" * 2_200_000))


def many_chapters(folder: Path) -> Path:
    return _matroska(folder / "chapters.mkv", _element(0x1043A770, _element(0x45B9, b"\xb6\x80" * 2_000_000)))


def many_tags(folder: Path) -> Path:
    return _matroska(folder / "tags.mkv", _element(0x1254C367, b"\x73\x73\x83\x67\xc8\x80" * 1_000_000))


def many_attachments(folder: Path) -> Path:
    return _matroska(folder / "attachments.mkv", _element(0x1941A469, b"\x61\xa7\x80" * 2_000))


def crossed_index(folder: Path) -> Path:
    """An AVI whose index of indexes names one list of 8,000 frames 10,000 times."""
    path = folder / "crossed.avi"
    data = honest_clip(path)
    listed, times = 8_000, 10_000
    strl = data.index(b"LIST", data.index(b"LIST") + 12)
    size = struct.unpack_from("<I", data, strl + 4)[0]
    hdrl = data.index(b"hdrl") - 8
    index_size = 24 + 16 * times
    entries = b"".join(struct.pack("<II", 1000 + 64 * k, 32) for k in range(listed))
    # placed at the very end of the file
    end = len(data) + 8 + index_size
    target = struct.pack("<QII", end, 32 + len(entries), listed)
    indx = b"indx" + struct.pack("<IHBBI4s12x", index_size, 4, 0, 0, times, b"00dc") + target * times
    leaf = b"ix00" + struct.pack("<IHBBI4sQI", 24 + len(entries), 2, 0, 1, listed, b"00dc", 0, 0) + entries
    out = bytearray(data[: strl + 8 + size] + indx + data[strl + 8 + size :] + leaf)
    for at in (4, hdrl + 4, strl + 4):
        struct.pack_into("<I", out, at, struct.unpack_from("<I", out, at)[0] + len(indx))
    path.write_bytes(bytes(out))
    return path


# --- pictures -------------------------------------------------------------------------------------------------


def _jpeg(path: Path, segments: bytes) -> Path:
    """An honest progressive JPEG of 96x64 with more segments before its end."""
    done, data = cv2.imencode(".jpg", colorful(3), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    assert done
    path.write_bytes(data.tobytes()[:-2] + segments + b"\xff\xd9")
    return path


def many_scans(folder: Path) -> Path:
    """A scan of the first coefficient that is one run of blocks without any, 40,000 times."""
    scan = b"\xff\xda" + struct.pack(">HBBBBBB", 8, 1, 1, 0, 1, 1, 0) + b"\x7f"
    return _jpeg(folder / "scans.jpg", scan * 40_000)


def png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _png(path: Path, chunks: bytes) -> Path:
    done, data = cv2.imencode(".png", colorful(3))
    assert done
    path.write_bytes(data.tobytes()[:33] + chunks + data.tobytes()[33:])
    return path


def many_chunks(folder: Path) -> Path:
    return _png(folder / "chunks.png", png_chunk(b"teSt", b"") * 200_000)


def many_profiles(folder: Path) -> Path:
    """A PNG of profiles, of which it may have one."""
    profiles = (profile(P3, gamma_curve(1.8 + k / 300)) for k in range(300))
    chunks = b"".join(png_chunk(b"iCCP", b"name\0\0" + zlib.compress(one)) for one in profiles)
    return _png(folder / "profiles.png", chunks)


def many_chunks_of_webp(folder: Path) -> Path:
    path = folder / "chunks.webp"
    done, data = cv2.imencode(".webp", colorful(3))
    assert done
    body = data.tobytes()[8:] + struct.pack("<4sI", b"teSt", 0) * 200_000
    path.write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
    return path


def many_segments(folder: Path) -> Path:
    path = folder / "segments.jpg"
    done, data = cv2.imencode(".jpg", colorful(3))
    assert done
    path.write_bytes(data.tobytes()[:2] + b"\xff\xe5\0\2" * 200_000 + data.tobytes()[2:])
    return path


def inflated_profile(folder: Path) -> Path:
    """A profile of 30 kB that grows to 30 MB."""
    return _png(folder / "profile.png", png_chunk(b"iCCP", b"x\0\0" + zlib.compress(bytes(30_000_000), 9)))


def inflated_text(folder: Path) -> Path:
    return _png(folder / "text.png", png_chunk(b"zTXt", b"x\0\0" + zlib.compress(bytes(30_000_000), 9)) * 4)


def second_header(folder: Path) -> Path:
    """A size that is allowed, and another after it."""
    return _png(folder / "second.png", png_chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0)))


def _tiff(path: Path, entries: list[tuple[int, int, int, bytes]], tail: bytes) -> Path:
    """entries: (tag, type, count, value or offset)."""
    fields = b"".join(struct.pack("<HHI", tag, kind, count) + value for tag, kind, count, value in sorted(entries))
    path.write_bytes(b"II*\0" + struct.pack("<IH", 8, len(entries)) + fields + bytes(4) + tail)
    return path


def _tags(width: int, height: int) -> list[tuple[int, int, int, bytes]]:
    numbers = {256: width, 257: height, 258: 8, 259: 1, 262: 1, 277: 1}
    return [(tag, 4, 1, struct.pack("<I", value)) for tag, value in numbers.items()]


def many_strips(folder: Path) -> Path:
    """Two million strips of no bytes."""
    count = 2_000_000
    entries = [*_tags(96, 64), (278, 4, 1, struct.pack("<I", 1))]
    at = struct.pack("<I", 8 + 2 + 12 * (len(entries) + 2) + 4)
    entries += [(273, 4, count, at), (279, 4, count, at)]
    return _tiff(folder / "strips.tif", entries, bytes(2 * 4 * count))


def huge_tile(folder: Path) -> Path:
    """One tile of a gigapixel for a picture of 96x64."""
    side = struct.pack("<I", 32_000)
    tiles = [
        (322, 4, 1, side),
        (323, 4, 1, side),
        (324, 4, 1, struct.pack("<I", 8)),
        (325, 4, 1, struct.pack("<I", 100)),
    ]
    return _tiff(folder / "tile.tif", [*_tags(96, 64), *tiles], bytes(200))


PICTURES: tuple[Callable[[Path], Path], ...] = (
    many_scans,
    many_chunks,
    many_chunks_of_webp,
    many_segments,
    inflated_profile,
    inflated_text,
    second_header,
    many_strips,
    huge_tile,
)
CLIPS: tuple[Callable[[Path], Path], ...] = (
    many_samples,
    misplaced_samples,
    many_samples_of_sound,
    many_samples_in_a_fragment,
    compressed_index,
    compressed_index_aside,
    many_samples_of_text,
    index_beyond_all_files,
    nested_boxes,
    many_boxes,
    many_tracks,
    many_cues,
    many_chapters,
    many_tags,
    many_attachments,
    crossed_index,
)
