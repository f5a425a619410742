from __future__ import annotations

import io
import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import MediaLimits, probe, read_frames, sha256_file
from tests.gallery.clips import change_boxes, encode_raw, libav_frame
from tests.gallery.pictures import colorful

_FRAMES = 45


def test_the_digest_is_that_of_the_bytes(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert sha256_file(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


_STAMPS = [0, 33, 67, 100, *range(300, 3000, 200)]
_SPAN_S = 2.9


def _stamped(
    stamps_ms: Sequence[int], container: str, codec: str, muxing: dict[str, str], encoding: dict[str, str]
) -> bytes:
    """A clip of frames with these stamps, which states a rate of 30 frames a second;  muxing, encoding: options."""
    written = io.BytesIO()
    with av.open(written, "w", format=container, options=muxing) as output:
        stream = output.add_stream(codec, rate=30, options=encoding)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for k, at in enumerate(stamps_ms):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 4 * k, np.uint8), format="rgb24")
            frame.pts, frame.time_base = at, Fraction(1, 1000)
            output.mux(stream.encode(frame.reformat(format="yuv420p")))
        output.mux(stream.encode(None))
    return written.getvalue()


def _stamped_webm(stamps_ms: Sequence[int], *, live: bool) -> bytes:
    """live: it states no length."""
    fast = {"deadline": "realtime", "cpu-used": "8"}
    return _stamped(stamps_ms, "webm", "libvpx-vp9", {"live": "1"} if live else {}, fast)


def _stamped_mp4(stamps_ms: Sequence[int], codec: str = "mpeg4", *, at_front: bool = False, **options: str) -> bytes:
    """at_front: its index stands before its pictures."""
    return _stamped(stamps_ms, "mp4", codec, {"moov_size": "9999"} if at_front else {}, options)


def recorded(*, live: bool) -> bytes:
    """A WebM of about 30 frames a second, stamped in milliseconds as they came, that states neither rate nor length."""
    stamps = np.round(np.arange(_FRAMES) * 1000 / 30 + np.random.default_rng(3).uniform(0, 9, 45)).astype(int)
    content = _stamped_webm(stamps.tolist(), live=live)
    at = content.index(b"\x23\xe3\x83\x84")  # DefaultDuration, of four bytes
    return content[:at] + b"\xec\x86" + bytes(6) + content[at + 8 :]  # Void


@pytest.mark.parametrize("live", [False, True])
def test_a_browsers_recording_has_the_rate_of_its_time_stamps(tmp_path: Path, live: bool) -> None:
    """It does not say one, and what libav guesses is the grid of the stamps, a thousand a second."""
    path = tmp_path / "recorded.webm"
    path.write_bytes(recorded(live=live))
    info = probe(path)
    assert info.frame_count == _FRAMES
    assert float(info.frame_rate or 0) == pytest.approx(30, rel=0.02)
    assert info.duration_s == pytest.approx(_FRAMES / 30, abs=0.1)
    assert len(list(read_frames(path))) == _FRAMES


def test_a_clip_lasts_from_its_first_frame_on(tmp_path: Path) -> None:
    """Stamps that begin after two hours, as of a piece of a live stream: the header counts from zero."""
    path = tmp_path / "late.mkv"
    path.write_bytes(_stamped_webm(range(7_200_000, 7_200_400, 40), live=False))
    assert probe(path).duration_s == pytest.approx(0.4, abs=0.05)


@pytest.mark.parametrize(("rate", "taken"), [(Fraction(24001, 100), True), (Fraction(245), False)])
def test_a_rate_that_averages_a_hair_above_the_limit_is_within_it(rate: Fraction, taken: bool, tmp_path: Path) -> None:
    path = encode_raw(tmp_path / "fast.mp4", [libav_frame(colorful(3, (96, 64)))] * 5, "mpeg4", rate=rate)
    if taken:
        assert probe(path).frame_rate == rate
    else:
        with pytest.raises(MediaError, match=r"245.00 frames a second; at most 240"):
            probe(path)


@pytest.mark.parametrize("flags", ["frag_keyframe", "frag_keyframe+empty_moov"])
def test_a_clip_in_fragments_has_the_frames_of_all_of_them(flags: str, tmp_path: Path) -> None:
    """The first fragment may be the index's own, which then counts its frames alone."""
    path = tmp_path / "fragments.mp4"
    with av.open(str(path), "w", options={"movflags": flags}) as output:
        stream: Any = output.add_stream("mpeg4", rate=25, options={"g": "5"})
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for k in range(20):
            picture = libav_frame(colorful(3, (96, 64)))
            picture.pts = k
            output.mux(stream.encode(picture))
        output.mux(stream.encode(None))
    info = probe(path, strict=True)
    assert (info.frame_count, info.frame_rate, info.duration_s, info.warnings) == (20, 25, 0.8, ())
    assert len(list(read_frames(path))) == 20
    with pytest.raises(MediaError, match="has 20 frames; at most 19"):
        probe(path, MediaLimits(max_frames=19))


def test_a_recording_of_a_rate_that_changes_has_the_length_of_its_stamps(tmp_path: Path) -> None:
    """It states the rate that it began with."""
    path = tmp_path / "slowing.webm"
    path.write_bytes(_stamped_webm(_STAMPS, live=True))
    info = probe(path)
    assert (info.frame_count, info.frame_rate) == (18, Fraction(17_000, 2900))
    assert info.duration_s == pytest.approx(2.9 + 2.9 / 17)
    path.write_bytes(_stamped_webm([round(k * 1000 / 30) for k in range(10)], live=True))
    info = probe(path)
    assert (info.frame_count, info.frame_rate) == (10, 30)
    assert info.duration_s == pytest.approx(1 / 3, abs=0.001)


def _lying_webm(seconds: float) -> bytes:
    content = bytearray(_stamped_webm(_STAMPS, live=False))
    at = content.index(b"\x44\x89\x88") + 3  # Duration, in milliseconds
    content[at : at + 8] = struct.pack(">d", 1000 * seconds)
    return bytes(content)


def _lying_mp4(seconds: float) -> bytes:
    content = bytearray(_stamped_mp4(_STAMPS))
    at = content.index(b"mdhd") + 16  # its time scale, and its length in that
    scale = int.from_bytes(content[at : at + 4])
    content[at + 4 : at + 8] = round(seconds * scale).to_bytes(4)
    return bytes(content)


@pytest.mark.parametrize("lying", [_lying_webm, _lying_mp4])
def test_a_header_does_not_end_a_clip_before_its_last_frame(lying: Callable[[float], bytes], tmp_path: Path) -> None:
    """Its seconds were counted as it said, and previews of what came later refused."""
    path = tmp_path / "clip"
    path.write_bytes(lying(0.5))
    info = probe(path)
    assert info.frame_count == len(_STAMPS)
    assert info.duration_s == pytest.approx(_SPAN_S + _SPAN_S / 17, abs=0.02)
    with pytest.raises(MediaError, match=r"lasts 3\.1 s; at most 2\.0 s"):
        probe(path, MediaLimits(max_duration_s=2.0))


def test_a_last_frame_may_stand_for_as_long_as_a_header_says(tmp_path: Path) -> None:
    path = tmp_path / "still.webm"
    path.write_bytes(_lying_webm(60.0))
    assert probe(path).duration_s == 60.0


def test_a_last_frame_that_is_decoded_early_counts_where_it_is_shown(tmp_path: Path) -> None:
    """Muxers write a length that goes by the order of decoding, in which the gap before it is not seen."""
    path = tmp_path / "still.mp4"
    path.write_bytes(_stamped_mp4([0, 40, 80, 120, 160, 8000], "libx264", bf="3"))
    with av.open(str(path)) as clip:
        (stream,) = clip.streams.video
        assert stream.duration is not None
        assert stream.time_base is not None
        assert stream.duration * stream.time_base < 1
    info = probe(path)
    assert info.frame_count == 6
    assert info.duration_s > 8


def test_frames_of_several_edits_are_those_that_are_shown(tmp_path: Path) -> None:
    """All of the media's were counted, and held to the limit."""
    source = tmp_path / "edited.mp4"
    source.write_bytes(_stamped_mp4(range(0, 24 * 40, 40)))

    def twice(edits: bytes) -> bytes:
        length, begin = struct.unpack_from(">Ii", edits, 8)
        return struct.pack(">IIIiIIiI", 0, 2, length // 4, begin, 1 << 16, length // 4, begin, 1 << 16)

    change_boxes(source, b"elst", twice)
    shown = sum(1 for _ in read_frames(source))
    assert shown == 12
    assert probe(source, MediaLimits(max_frames=12)).frame_count == shown


def test_an_mp4_whose_last_box_runs_to_its_end_is_cut_short_by_its_index(tmp_path: Path) -> None:
    """No box says how many bytes there ought to be: it passed as whole, with all frames of its index."""
    content = bytearray(_stamped_mp4(range(0, 24 * 40, 40), at_front=True))
    at = content.index(b"mdat") - 4
    content[at : at + 4] = bytes(4)
    path = tmp_path / "clip.mp4"
    path.write_bytes(content)
    assert probe(path, strict=True).frame_count == 24
    path.write_bytes(content[: (at + len(content)) // 2])
    with pytest.raises(MediaError, match="is cut short"):
        probe(path, strict=True)
    info = probe(path)
    assert 0 < info.frame_count == sum(1 for _ in read_frames(path)) < 24
    assert "of 24 frames are read" in info.warnings[0]


class _Pipe:
    """A target that cannot be gone back in."""

    def __init__(self) -> None:
        self.data = bytearray()

    def write(self, data: bytes) -> int:
        self.data += data
        return len(data)


def _piped_avi(path: Path) -> Path:
    pipe, base = _Pipe(), colorful(3, (96, 64))
    target: Any = pipe
    with av.open(target, "w", format="avi") as output:
        stream: Any = output.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for k in range(20):
            picture = libav_frame(np.roll(base, k, 1))
            picture.pts = k
            output.mux(stream.encode(picture))
        output.mux(stream.encode(None))
    assert pipe.data[4:8] == b"\xff" * 4
    path.write_bytes(pipe.data)
    return path


def _unfinished_avi(path: Path) -> Path:
    """As a recorder leaves it whose power fails: no sizes, no index."""
    data = bytearray(_piped_avi(path).read_bytes())
    data[4:8] = bytes(4)
    path.write_bytes(data[: data.index(b"idx1")] if b"idx1" in data else data)
    return path


@pytest.mark.parametrize("made", [_piped_avi, _unfinished_avi])
def test_an_avi_whose_header_was_never_filled_in_has_its_frames_counted(
    made: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = made(tmp_path / "a.avi")
    info = probe(path, strict=True)
    assert (info.frame_count, info.frame_rate, info.duration_s, info.warnings) == (20, 25, 0.8, ())
    assert len(list(read_frames(path))) == 20
    with pytest.raises(MediaError, match="has 20 frames; at most 19"):
        probe(path, MediaLimits(max_frames=19))


def test_an_avi_that_claims_more_frames_than_it_has_bytes_has_them_counted(tmp_path: Path) -> None:
    path = encode_raw(tmp_path / "a.avi", [libav_frame(colorful(3, (96, 64)))] * 5, "mpeg4")
    data = bytearray(path.read_bytes())
    for place in (data.index(b"avih") + 8 + 16, data.index(b"strh") + 8 + 32):
        data[place : place + 4] = (10**6).to_bytes(4, "little")
    path.write_bytes(data)
    assert probe(path).frame_count == 5
