"""Container × codec × depth × streams: what comes back equals what went in, is named in the plan, or is refused.

Each clip is written with each way out, and the new file is taken stock of by the same code that took stock of the
source: every difference must be named, and nothing named as kept may differ.
"""

from __future__ import annotations

import zlib
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.stream import Disposition

from pvg.errors import MediaError
from pvg.video import Frame, MediaInfo, Plan, Streams, VideoWriter, inspect, make_plan, probe, read_frames, read_streams
from pvg.video.decoding import has_alpha
from pvg.video.formats import PixelFormat, resolve_format
from pvg.video.pixel_aspect import say_pixel_aspect
from pvg.video.streams import Track, fields_of, streams_of
from tests.gallery.clips import encode_raw, media_info, rewrite_clip, smooth_frames
from tests.gallery.rich_clips import FRAMES, Other, Rich

_DEFAULT, _COMMENT = Disposition.default, Disposition.comment
_TAGS = {
    "title": "A walk",
    "artist": "Somebody",
    "creation_time": "2024-03-01T10:20:30.000000Z",
    "com.apple.quicktime.make": "Maker",
    "com.apple.quicktime.location.ISO6709": "+48.1000+011.5000/",
    "location": "+48.1000+011.5000/",
}
_HDR = {
    "x265-params": "log-level=none:master-display=G(13250,34500)B(7500,3000)R(34000,16000)WP(15635,16450)"
    "L(10000000,50):max-cll=1000,400"
}
CLIPS = {
    "phone": Rich(
        ".mov",
        sounds=[Other("aac", "ger", "Ton", _DEFAULT)],
        tags=_TAGS,
        timecode="01:00:00:00",
    ),
    "edited": Rich(
        ".mov",
        "prores_ks",
        "yuv422p10le",
        (256, 128),
        {"profile": "hq"},
        sounds=[
            Other("pcm_f32le", "ger", "Ton", _DEFAULT),
            Other("pcm_f64le", "eng", "Comments"),
            Other("pcm_s24le", "fra"),
        ],
        subtitles=[Other("mov_text", "eng", "Words", _DEFAULT)],
        chapters=2,
        timecode="10:20:30:12",
    ),
    "shared": Rich(
        ".mkv",
        layout="yuv444p",
        sounds=[Other("libopus", "ger", "Ton", _DEFAULT), Other("flac", "eng", "Comments", _COMMENT)],
        subtitles=[Other("srt", "eng", "Words"), Other("ass", "ger", "Wörter"), Other("webvtt", "fra")],
        chapters=2,
        tags={"title": "A walk", "location": "+48.1000+011.5000/"},
        attachment=b"not a font",
    ),
    "HDR10": Rich(".mp4", "libx265", "yuv420p10le", (128, 128), _HDR, color=(9, 9, 16, 1)),
    "top first": Rich(".mov", "libx264", size=(256, 128), fields="tff", options={"x264-params": "tff=1"}),
    "bottom first": Rich(".mov", "prores_ks", "yuv422p10le", (256, 128), {"profile": "hq"}, fields="bff"),
    "alpha": Rich(".mov", "prores_ks", "yuva444p10le", options={"profile": "4444", "alpha_bits": "16"}),
    "full range": Rich(".mkv", size=(256, 128), color=(1, 1, 1, 2)),
}
WAYS = [
    *(("mp4", codec) for codec in ("h264", "hevc", "vp9", "av1")),
    *(("mov", codec) for codec in ("h264", "hevc", "prores", "prores4444", "dnxhr")),
    *(("mkv", codec) for codec in ("h264", "hevc", "ffv1", "prores4444")),
    *(("webm", codec) for codec in ("vp9", "av1")),
    *(("nut", codec) for codec in ("raw", "ffv1")),
]


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("rich")
    return {name: rich.write(folder, name.replace(" ", "_")) for name, rich in CLIPS.items()}


def planned(source: Path, container: str, codec: str) -> Plan:
    return make_plan(probe(source), container=container, codec=codec, source=source, streams=read_streams(source))


def stock_of(path: Path) -> tuple[Streams, tuple[object, ...]]:
    """What a new file holds, and the code points, depth and chroma of its pictures."""
    if path.suffix == ".nut":  # taken by pipe alone, so looked at here without the door for files
        with av.open(str(path)) as opened:
            picture = next(opened.decode(video=0))
            seen = resolve_format(picture.format.name, picture.width, picture.height, 2, 0)
            alpha = has_alpha(picture)
            streams = streams_of(opened, opened.streams.video[0].index, {}, fields_of(picture), alpha)
        return streams, ((2, 2, 2, 0), (seen.depth, seen.chroma_log2))
    info = probe(path)
    return read_streams(path), (
        (info.color_primaries, info.color_transfer, info.color_matrix, info.color_range),
        (info.format.depth, info.format.chroma_log2),
    )


def of_kind(streams: Streams, kind: str) -> list[Track]:
    """The tracks of one kind, in the file's order."""
    return [track for track in streams.tracks if track.kind == kind]


def first_picture_s(path: Path) -> float:
    with av.open(str(path)) as opened:
        stamps = [packet.pts for packet in opened.demux(video=0) if packet.pts is not None]
        return float(min(stamps) * (opened.streams.video[0].time_base or 0))


def same_chapters(before: Streams, after: Streams, moved_s: float) -> bool:
    """Within the milliseconds of Matroska; moved_s: by which the pictures begin later."""
    ours, theirs = before.chapters, after.chapters
    return [one.title for one in ours] == [one.title for one in theirs] and all(
        abs(float(other.start_s - one.start_s) - moved_s) < 2e-3
        and abs(float(other.end_s - one.end_s) - moved_s) < 2e-3
        for one, other in zip(ours, theirs, strict=True)
    )


def differences(before: Streams, after: Streams, moved_s: float) -> list[str]:
    """Words that must be among the lines: one for each thing that is not as it was."""
    found = []
    for kind in ("sound", "subtitle"):
        ours, theirs = of_kind(before, kind), of_kind(after, kind)
        found += [f"{kind} track {track.index}" for track in ours[len(theirs) :]]
        for one, other in zip(ours, theirs, strict=False):
            if one.codec != other.codec:
                found.append(f"{kind} track {one.index}")
            if (one.language, one.title) != (other.language, other.title):
                found.append(f"{kind} track {one.index}")
            if set(one.dispositions) - {"default"} != set(other.dispositions) - {"default"}:
                found.append("its mark (")
            if "default" in {*one.dispositions} ^ {*other.dispositions}:
                found.append("marked as default")
    found += ["attachment"] * (of_kind(before, "attachment") != of_kind(after, "attachment"))
    found += ["chapters"] * (not same_chapters(before, after, moved_s))
    found += ["tags are not kept"] * (dict(before.metadata) != dict(after.metadata))
    found += ["tags that tell a place"] * (before.location != after.location)
    found += ["timecode"] * (before.timecode != after.timecode)
    found += ["alpha"] * (before.alpha != after.alpha)
    found += ["fields"] * (before.fields != after.fields)
    found += ["mastering display"] * (not same_mastering(before, after))
    found += ["content light"] * (before.light != after.light)
    return found


def same_mastering(before: Streams, after: Streams) -> bool:
    """Within the coarser steps of AV1 (1/65536 and 1/16384, 1/256 cd/m²)."""
    ours, theirs = before.mastering, after.mastering
    if ours is None or theirs is None:
        return ours is theirs
    corners = zip(
        [*ours.red, *ours.green, *ours.blue, *ours.white],
        [*theirs.red, *theirs.green, *theirs.blue, *theirs.white],
        strict=True,
    )
    return (
        all(abs(a - b) < Fraction(1, 20000) for a, b in corners)
        and abs(ours.least - theirs.least) < Fraction(1, 5000)
        and abs(ours.most - theirs.most) < Fraction(1, 100)
    )


@pytest.mark.parametrize("name", list(CLIPS))
def test_every_cell_is_equal_named_or_refused(name: str, clips: dict[str, Path], tmp_path: Path) -> None:
    source = clips[name]
    before, (tags, shape) = stock_of(source)
    done, refused = [], []
    for container, codec in WAYS:
        try:
            plan = planned(source, container, codec)
        except ValueError as error:
            refused.append(str(error))
            continue
        done.append((container, codec))
        target = rewrite_clip(source, tmp_path / f"{codec}.{container}", plan)
        after, (new_tags, new_shape) = stock_of(target)
        lines = "\n".join(plan.warnings)
        needed = differences(before, after, first_picture_s(target) - first_picture_s(source))
        needed += ["pictures become"] * (shape != new_shape and not (name == "alpha" and "4444" in codec))
        if tags != new_tags:
            needed.append("colour tags" if container == "nut" else "studio range")
        for words in needed:
            assert words in lines, (container, codec, words, plan.warnings, after)
        for line in plan.warnings:  # and nothing is called lost that is there
            assert any(words in line for words in [*needed, "goes without"]) or "pictures become" in line, line
        assert [len(of_kind(after, "picture")), of_kind(after, "data")] == [0, []]
    for line in refused:
        assert "\n" not in line
        assert ("interlaced" in line and before.fields) or ("too small" in line and CLIPS[name].size < (256, 120)), line
    assert len(done) > 5


def test_sound_is_copied_as_it_is(clips: dict[str, Path], tmp_path: Path) -> None:
    """All tracks, float PCM too, byte for byte at the same times."""
    for container in ("mov", "mkv"):
        target = rewrite_clip(clips["edited"], tmp_path / f"o.{container}", planned(clips["edited"], container, "h264"))
        assert [b"".join(data for data, _ in track) for track in packets(target)] == [
            b"".join(data for data, _ in track) for track in packets(clips["edited"])
        ]
        assert [track[0][1] for track in packets(target)] == [0, 0, 0]
        assert [track.codec for track in of_kind(read_streams(target), "sound")] == [
            "pcm_f32le",
            "pcm_f64le",
            "pcm_s24le",
        ]


def packets(path: Path) -> list[list[tuple[bytes, Fraction]]]:
    """(bytes, time) of every packet of every sound track."""
    found = []
    for index in range(len(of_kind(read_streams(path), "sound"))):
        with av.open(str(path)) as opened:
            coded = opened.demux(opened.streams.audio[index])
            found.append([(bytes(one), (one.pts or 0) * one.time_base) for one in coded if one.size])
    return found


@pytest.mark.parametrize("name", ["shared", "HDR10", "phone"])
@pytest.mark.parametrize(("container", "codec"), [("mkv", "ffv1"), ("mkv", "av1"), ("webm", "vp9")])
@pytest.mark.parametrize("aspect", [Fraction(4, 3), Fraction(99, 70), Fraction(1, 40), Fraction(300)])
def test_a_file_that_is_told_its_pixel_aspect_is_the_same_otherwise(
    name: str, container: str, codec: str, aspect: Fraction, clips: dict[str, Path], tmp_path: Path
) -> None:
    plan = planned(clips[name], container, codec)
    square, told = (
        rewrite_clip(clips[name], tmp_path / f"{word}.{container}", replace(plan, aspect=shape))
        for word, shape in (("square", Fraction(1)), ("told", aspect))
    )
    seen = probe(told)
    assert seen.sample_aspect_ratio == pytest.approx(float(aspect), rel=0.5 / min(seen.width, seen.height))
    assert replace(seen, sample_aspect_ratio=Fraction(1)) == probe(square)
    assert stock_of(told) == stock_of(square)
    assert told.stat().st_size == square.stat().st_size
    ours, theirs = segment_of(told), segment_of(square)
    for identity in (INFO, TRACKS, CUES):  # the list of parts leads to each
        body, _ = element_at(ours, place_of(ours, identity), identity)
        if identity != TRACKS:
            assert body == element_at(theirs, place_of(theirs, identity), identity)[0]
        if body[0] == CHECKSUM:
            assert body[2:6] == zlib.crc32(body[6:]).to_bytes(4, "little")
    listed, _ = element_at(ours, 0, LIST)
    assert listed[0] != CHECKSUM or listed[2:6] == zlib.crc32(listed[6:]).to_bytes(4, "little")
    _, end = element_at(ours, place_of(ours, TRACKS), TRACKS)
    assert end == element_at(theirs, place_of(theirs, TRACKS), TRACKS)[1]
    assert ours[end:] == theirs[end:]
    with av.open(str(told)) as ours_opened, av.open(str(square)) as theirs_opened:
        for opened in (ours_opened, theirs_opened):
            opened.seek(300_000, backward=True)
        one, other = next(ours_opened.decode(video=0)), next(theirs_opened.decode(video=0))
        assert one.pts == other.pts
        assert np.array_equal(one.to_ndarray(), other.to_ndarray())


def test_an_odd_clip_keeps_the_shape_of_its_pixels(media_dir: Path, tmp_path: Path) -> None:
    source = media_dir / "odd" / "odd_641x479_vp9.webm"
    assert probe(source).sample_aspect_ratio == Fraction(479, 641)
    for container, codec in (("webm", "vp9"), ("mkv", "ffv1")):
        plan = planned(source, container, codec)
        assert not [line for line in plan.warnings if "pixels of" in line]
        assert probe(rewrite_clip(source, tmp_path / f"o.{container}", plan)).sample_aspect_ratio == Fraction(479, 641)


def test_a_pixel_aspect_is_called_dropped_where_it_is_not_written() -> None:
    info = info_of((96, 64), sample_aspect_ratio=Fraction(4, 3))
    said = {name: make_plan(info, container=name, codec="raw").dropped for name in ("nut", "y4m")}
    assert "pixels of 4:3 are not kept: they are not written to NUT" in said["nut"]
    assert not any("pixels" in line for line in said["y4m"])


def test_a_file_that_is_not_as_libav_makes_it_is_not_touched(tmp_path: Path) -> None:
    for content in (b"", b"\x1a\x45\xdf\xa3\x80", bytes(range(1, 200))):
        (path := tmp_path / "o.webm").write_bytes(content)
        with pytest.raises(MediaError, match=r"o\.webm"):
            say_pixel_aspect(path, Fraction(4, 3))
        assert path.read_bytes() == content


LIST, INFO, TRACKS, CUES = b"\x11\x4d\x9b\x74", b"\x15\x49\xa9\x66", b"\x16\x54\xae\x6b", b"\x1c\x53\xbb\x6b"
CHECKSUM = 0xBF
"""Elements of Matroska (RFC 9559)."""


def segment_of(path: Path) -> bytes:
    """The body of a Matroska file's segment, from which places are counted."""
    data = path.read_bytes()
    return data[data.index(b"\x18\x53\x80\x67") + 12 :]


def place_of(segment: bytes, identity: bytes) -> int:
    """Where the list of a segment's parts says that this one is."""
    entry = segment.index(b"\x53\xab\x84" + identity + b"\x53\xac") + 9
    return int.from_bytes(segment[entry + 1 : entry + 1 + (segment[entry] & 0x7F)], "big")


def element_at(segment: bytes, place: int, identity: bytes) -> tuple[bytes, int]:
    """The body of the element there, which has this identity, and where it ends."""
    at = place + len(identity)
    assert segment[place:at] == identity
    width = 9 - segment[at].bit_length()
    body = at + width
    end = body + (int.from_bytes(segment[at:body], "big") & (1 << 7 * width) - 1)
    return segment[body:end], end


def test_lossless_sound_stays_lossless_where_pcm_goes(clips: dict[str, Path], tmp_path: Path) -> None:
    target = rewrite_clip(clips["shared"], tmp_path / "o.mov", planned(clips["shared"], "mov", "h264"))
    assert [track.codec for track in of_kind(read_streams(target), "sound")] == ["aac", "pcm_s16le"]
    np.testing.assert_array_equal(samples(target, 1), samples(clips["shared"], 1))


def samples(path: Path, index: int) -> np.ndarray:
    with av.open(str(path)) as opened:
        stream = opened.streams.audio[index]
        return np.concatenate([frame.to_ndarray().reshape(-1) for frame in opened.decode(stream)])


@pytest.mark.parametrize(("container", "codec"), [("mp4", "h264"), ("mov", "h264"), ("mkv", "h264"), ("webm", "vp9")])
def test_the_pictures_stay_the_default_track(
    container: str, codec: str, clips: dict[str, Path], tmp_path: Path
) -> None:
    source = clips["edited"]
    target = rewrite_clip(source, tmp_path / f"o.{container}", planned(source, container, codec))
    for path in (source, target):
        with av.open(str(path)) as opened:
            assert opened.streams.video[0].disposition & av.stream.Disposition.default


@pytest.mark.parametrize(("container", "codec"), [("mp4", "h264"), ("mov", "h264"), ("mkv", "h264"), ("webm", "vp9")])
def test_subtitles_say_the_same_at_the_same_times(
    container: str, codec: str, clips: dict[str, Path], tmp_path: Path
) -> None:
    for name in ("edited", "shared"):
        target = rewrite_clip(clips[name], tmp_path / f"{name}.{container}", planned(clips[name], container, codec))
        assert texts(target) == texts(clips[name])
        assert {line for track in texts(target) for line in track} == {
            (b"Line 0", Fraction(0), Fraction(2, 25)),
            (b"Line 1", Fraction(1, 10), Fraction(2, 25)),
        }


def texts(path: Path) -> list[list[tuple[bytes, Fraction, Fraction]]]:
    """(text, start, length in seconds) of every line of every subtitle track."""
    found = []
    with av.open(str(path)) as opened:
        for stream in opened.streams.subtitles:
            opened.seek(0)
            found.append(
                [
                    (shown.dialogue, packet.pts * packet.time_base, packet.duration * packet.time_base)
                    for packet in opened.demux(stream)
                    if packet.size
                    for shown in packet.decode()
                ]
            )
    return found


def test_ffv1_gives_every_sample_back(clips: dict[str, Path], tmp_path: Path) -> None:
    for name in ("phone", "edited", "shared", "HDR10", "top first", "bottom first", "full range"):
        source = clips[name]
        target = rewrite_clip(source, tmp_path / f"{name}.mkv", planned(source, "mkv", "ffv1"))
        frames = list(zip(read_frames(source), read_frames(target), strict=True))
        assert len(frames) == FRAMES
        for before, after in frames:
            assert before.format == after.format
            for plane, other in zip(before.planes, after.planes, strict=True):
                np.testing.assert_array_equal(plane, other)


def test_interlaced_chroma_is_converted_field_by_field(clips: dict[str, Path], tmp_path: Path) -> None:
    """From 4:2:0 to 4:2:2 each field's chroma comes from its own lines."""
    info, fmt = probe(clips["top first"]), PixelFormat("yuv420p", 8, (1, 1), (0.2126, 0.0722), False)
    chroma = np.full((64, 128), 90, np.uint8)
    chroma[1::2] = 170  # the lower field's colour is another
    frame = Frame(0, 0, 0.0, fmt, (np.full((128, 256), 100, np.uint8), chroma, chroma))
    plan = make_plan(info, container="mov", codec="prores", streams=Streams(fields="tff"))
    with VideoWriter(tmp_path / "o.mov", info, fmt, plan=plan) as writer:
        writer.write(frame)
    seen = next(read_frames(tmp_path / "o.mov")).planes[1].astype(int) / 4
    assert abs(seen[0::2].mean() - 90) < 1
    assert abs(seen[1::2].mean() - 170) < 1
    assert seen[0::2].std() < 2


@pytest.mark.parametrize(("container", "codec"), [("mov", "prores4444"), ("mkv", "ffv1"), ("nut", "raw")])
@pytest.mark.parametrize("depth", [8, 10])
def test_alpha_goes_where_the_codec_has_it(container: str, codec: str, depth: int, tmp_path: Path) -> None:
    layout = "yuv444p" if depth == 8 else "yuv444p10le"
    fmt = PixelFormat(layout, depth, (0, 0), (0.2126, 0.0722), False)
    height, width = 64, 96
    alpha = (np.arange(width, dtype=fmt.dtype) * 2 ** (depth - 8)).reshape(1, -1).repeat(height, 0)
    info = media_info(fmt, has_alpha=True)
    plan = make_plan(info, container=container, codec=codec, streams=Streams(alpha=True))
    assert (plan.alpha, [line for line in plan.warnings if "alpha" in line]) == (True, [])
    path = tmp_path / f"o.{container}"
    with VideoWriter(path, info, fmt, plan=plan) as writer:
        for frame in smooth_frames(2, fmt):
            writer.write(replace(frame, alpha=alpha))
    with av.open(str(path)) as opened:
        picture = next(opened.decode(video=0))
    component = picture.format.components[3]
    plane = picture.planes[component.plane]
    kind = np.uint8 if component.bits == 8 else np.uint16
    stored = np.frombuffer(memoryview(plane), kind).reshape(-1, plane.line_size // kind().itemsize)[:height, :width]
    assert np.abs(stored / (2**component.bits - 1) - alpha / (2**depth - 1)).max() < 2e-3


def test_alpha_is_called_dropped_elsewhere() -> None:
    fmt = PixelFormat("yuv444p10le", 10, (0, 0), (0.2126, 0.0722), False)
    for container, codec in (("mp4", "hevc"), ("mov", "prores"), ("webm", "vp9"), ("y4m", "raw")):
        plan = make_plan(media_info(fmt, has_alpha=True), container=container, codec=codec)
        assert not plan.alpha
        assert any("alpha is not kept" in line for line in plan.dropped)


def test_rgb_stays_rgb_in_ffv1(tmp_path: Path) -> None:
    for depth, name in ((8, "gbrp"), (10, "gbrp10le")):
        fmt = PixelFormat(name, depth, (0, 0), None, True)
        rng = np.random.default_rng(2)
        planes = tuple(rng.integers(0, 2**depth, (64, 96), dtype=fmt.dtype) for _ in range(3))
        path = tmp_path / f"{name}.mkv"
        plan = make_plan(media_info(fmt), container="mkv", codec="ffv1")
        assert plan.warnings == ()
        with VideoWriter(path, media_info(fmt), fmt, plan=plan) as writer:
            writer.write(Frame(0, 0, 0.0, fmt, planes))  # type: ignore[arg-type]
        with av.open(str(path)) as opened:
            seen = next(opened.decode(video=0)).reformat(format=name).to_ndarray()
        np.testing.assert_array_equal(seen, np.stack(planes, axis=-1))


@pytest.mark.parametrize(
    ("layout", "codec", "line"),
    [
        (
            "yuv420p16le",
            "ffv1",
            "become Y'CbCr 4:2:0, 12 bits (the clip's are Y'CbCr 4:2:0, 16 bits), the nearest that",
        ),
        ("yuv422p14le", "h264", "become Y'CbCr 4:2:2, 10 bits (the clip's are Y'CbCr 4:2:2, 14 bits), as H.264 has it"),
        ("yuv420p9le", "h264", "become Y'CbCr 4:2:0, 10 bits (the clip's are Y'CbCr 4:2:0, 9 bits), the nearest that"),
        ("yuv411p", "h264", "become Y'CbCr 4:2:2, 8 bits (the clip's are Y'CbCr 4:1:1, 8 bits), the nearest that"),
        ("yuv410p", "ffv1", "become Y'CbCr 4:2:0, 8 bits (the clip's are Y'CbCr 4:1:0, 8 bits), the nearest that"),
        ("yuv440p", "h264", "become Y'CbCr 4:4:4, 8 bits (the clip's are Y'CbCr 4:4:0, 8 bits), the nearest that"),
        ("gray16le", "ffv1", "become Y'CbCr 4:2:0, 12 bits (the clip's are grey, 16 bits), the nearest that"),
        ("gray", "ffv1", ""),
        ("bgr0", "ffv1", ""),
        ("gbrp14le", "ffv1", ""),
    ],
)
def test_a_depth_or_chroma_that_no_look_is_drawn_in_is_said(layout: str, codec: str, line: str, tmp_path: Path) -> None:
    pictures = [av.VideoFrame(96, 64, layout) for _ in range(2)]
    source = encode_raw(tmp_path / "source.mkv", pictures, "ffv1", level="3", strict="experimental")
    plan = planned(source, "mkv", codec)
    assert [text for text in plan.changed if "pictures become" in text] == [
        text for text in plan.changed if line and line in text
    ]
    assert any(text.startswith("pictures") for text in plan.kept) == (not line)
    assert inspect(source, container="mkv", codec=codec)["output"]["changed"] == list(plan.changed)


def test_a_sideways_clip_keeps_its_chroma_where_the_codec_has_no_other(tmp_path: Path) -> None:
    info = replace(info_of((64, 64), rotation=90), pixel_format="yuv422p10le", format=_SIDEWAYS)
    assert any(
        "become Y'CbCr 4:4:4, 10 bits (the clip's are Y'CbCr 4:2:2, 10 bits)" in line
        for line in make_plan(info, container="mkv", codec="ffv1").changed
    )
    assert "pictures: Y'CbCr 4:2:2, 10 bits" in make_plan(info, container="mov", codec="prores").kept


_SIDEWAYS = PixelFormat("yuv444p10le", 10, (0, 0), (0.2126, 0.0722), False)


def info_of(size: tuple[int, int], **changes: object) -> MediaInfo:
    return media_info(PixelFormat("yuv420p", 8, (1, 1), (0.2126, 0.0722), False), size, **changes)


def test_what_cannot_be_written_is_refused_in_words() -> None:
    fields = Streams(fields="tff")
    for container, codec, streams, info, words in (
        ("mkv", "hevc", fields, info_of((64, 64)), "interlaced and HEVC has no fields here; write it as h264"),
        ("mov", "dnxhr", fields, info_of((256, 128)), "interlaced and DNxHR has no fields"),
        ("nut", "raw", fields, info_of((64, 64)), "uncompressed video has no fields here; write it as ffv1"),
        ("webm", "auto", fields, info_of((64, 64)), "interlaced and WebM holds no codec with fields"),
        ("mp4", "auto", fields, info_of((64, 64), rotation=90), "interlaced and turned"),
        ("mov", "dnxhr", Streams(), info_of((64, 64)), "too small for dnxhr"),
        ("mov", "ffv1", Streams(), info_of((64, 64)), "MOV holds .*, not ffv1; write .mkv"),
        ("mkv", "dnxhr", Streams(), info_of((64, 64)), "Matroska holds .*, not dnxhr; write .mov"),
        ("avi", "auto", Streams(), info_of((64, 64)), "is not one of"),
    ):
        with pytest.raises(ValueError, match=words):
            make_plan(info, container=container, codec=codec, streams=streams)


def test_auto_keeps_fields() -> None:
    fmt = PixelFormat("yuv420p10le", 10, (1, 1), (0.2126, 0.0722), False)
    plan = make_plan(media_info(fmt), container="mp4", streams=Streams(fields="bff"))
    assert (plan.codec, plan.format.depth, plan.fields) == ("h264", 10, "bff")


def test_a_timecode_that_the_container_would_refuse_is_called_lost(tmp_path: Path) -> None:
    for timecode, rate, kept in (
        ("01:00:00;00", Fraction(30000, 1001), True),
        ("01:00:00;00", Fraction(25), False),
        ("one o'clock", Fraction(25), False),
    ):
        info = info_of((96, 64), frame_rate=rate)
        plan = make_plan(info, container="mp4", streams=Streams(timecode=timecode))
        assert (plan.timecode is not None) is kept
        with VideoWriter(tmp_path / "o.mp4", info, info.format, plan=plan) as writer:
            writer.write(smooth_frames(1, info.format)[0])
        assert (read_streams(tmp_path / "o.mp4").timecode == timecode) is kept


@pytest.mark.parametrize("container", ["mp4", "mov", "mkv", "webm"])
def test_tags_come_back_whatever_their_names(container: str, tmp_path: Path) -> None:
    """Each alone: some muxers know a name, and all names have a place."""
    info = info_of((96, 64))
    for name in ("title", "album_artist", "composer", "description", "com.example.take", "season_number"):
        plan = make_plan(info, container=container, streams=Streams(metadata=((name, "7"),)))
        with VideoWriter(tmp_path / f"o.{container}", info, info.format, plan=plan) as writer:
            writer.write(smooth_frames(1, info.format)[0])
        assert read_streams(tmp_path / f"o.{container}").metadata == ((name, "7"),)


@pytest.mark.parametrize(
    ("language", "stored"),
    [("deu", "ger"), ("nld", "dut"), ("ces", "ces"), ("cze", "ces"), ("swe", "swe"), ("hrv", "hrv"), ("gsw", None)],
)
def test_a_language_is_that_of_quicktime_in_mov_or_called_lost(
    language: str, stored: str | None, tmp_path: Path
) -> None:
    source = Rich(".mkv", sounds=[Other("aac", language)]).write(tmp_path, "spoken")
    plan = planned(source, "mov", "h264")
    (track,) = of_kind(read_streams(rewrite_clip(source, tmp_path / "o.mov", plan)), "sound")
    assert track.language == stored
    assert any("goes without its language" in line for line in plan.dropped) == (stored is None)
    assert planned(source, "mp4", "h264").dropped == ()


@pytest.mark.parametrize("container", ["mp4", "mov", "mkv"])
def test_a_sound_track_that_becomes_the_default_one_is_named(container: str, tmp_path: Path) -> None:
    source = Rich(".mkv", sounds=[Other("aac")]).write(tmp_path, "unmarked")
    assert of_kind(read_streams(source), "sound")[0].dispositions == ()
    plan = planned(source, container, "h264")
    (track,) = of_kind(read_streams(rewrite_clip(source, tmp_path / f"o.{container}", plan)), "sound")
    assert ("default" in track.dispositions) == (container != "mkv")
    assert any("is marked as default" in line for line in plan.changed) == (container != "mkv")


def test_a_reel_name_goes_with_the_timecode_of_mov_or_is_called_lost(tmp_path: Path) -> None:
    plain = Rich(".mov", timecode="01:00:00:00").write(tmp_path, "plain")
    plan = planned(plain, "mov", "h264")
    source = rewrite_clip(plain, tmp_path / "source.mov", replace(plan, reel="A001C003"))
    assert read_streams(source).reel == "A001C003"
    for container, codec in (("mov", "prores"), ("mp4", "h264"), ("mkv", "ffv1")):
        plan = planned(source, container, codec)
        after = read_streams(rewrite_clip(source, tmp_path / f"o.{container}", plan))
        assert after.timecode == "01:00:00:00"
        assert after.reel == ("A001C003" if container == "mov" else None)
        assert any("reel name A001C003 is not kept" in line for line in plan.dropped) == (container != "mov")


def test_streams_of_a_file_that_is_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("hello")
    with pytest.raises(MediaError, match=r"text\.mp4"):
        read_streams(tmp_path / "text.mp4")
