"""What becomes of every odd file: read, with these properties, or refused in this line. One table for all of them.

The files of shared/media/odd are named; those made on the spot are described. A file without a row fails.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import pvg
from pvg.errors import MediaError
from pvg.video import MediaInfo, MediaLimits, probe, read_frames, read_image, write_image
from tests.gallery.clips import encode_raw, libav_frame, write_clip
from tests.gallery.odd_clips import FRAMES, MADE, changed_fields, changed_tags, late_start_mkv, lost_blocks, open_group


@dataclass(frozen=True)
class Read:
    """A file that is read.

    size: upright (width, height). frames: exactly. first_s, last_s: time stamps of the first and last frame, None for
    any. format: the planes delivered. warns: in the warning of `probe`, None without one. strict: in the line that
    refuses the file when nothing may be missing, None when it is whole.
    """

    size: tuple[int, int]
    frames: int
    first_s: float | None = 0.0
    last_s: float | None = None
    format: str = "yuv420p"
    rotation: int = 0
    has_audio: bool | None = None
    warns: str | None = None
    strict: str | None = None


@dataclass(frozen=True)
class Refused:
    """A file that is refused: by `probe`, or where its frames are read (late); line: a pattern of the message."""

    line: str
    late: bool = False


KIND = "accepted are MP4, MOV, WebM, MKV and AVI clips and JPEG, PNG, TIFF and still WebP pictures"

TABLE: dict[str, Read | Refused] = {
    # files of the folder
    "animation.gif": Refused(f"is a GIF; {KIND}"),
    "audio_longer_than_video.mp4": Read((524, 524), 50, has_audio=True),
    "bad_bomb_16384x16384.png": Refused("is 16384x16384 = 268435456 pixels; at most 33554432 are accepted"),
    "bad_bomb_8192x8192_12_frames_valid_h264.mp4": Refused("is 8192x8192 = 67108864 pixels; at most 33554432"),
    "bad_declares_16384x16384_header_only.mp4": Refused("is 16384x16384 = 268435456 pixels; at most 33554432"),
    "bad_external_dref_file.mp4": Refused("keeps its data in another file or address"),
    "bad_external_dref_http.mp4": Refused("keeps its data in another file or address"),
    "bad_ffconcat_named.mp4": Refused(f"is an ffconcat script; {KIND}"),
    "bad_hls_file_etc_passwd.m3u8": Refused(f"is an HLS playlist; {KIND}"),
    "bad_hls_http_loopback.m3u8": Refused(f"is an HLS playlist; {KIND}"),
    "bad_hls_named.mp4": Refused(f"is an HLS playlist; {KIND}"),
    "bad_jpeg_named.mp4": Read((800, 542), 1, format="rgb24"),
    "bad_moov_missing.mp4": Refused("has no index \\(moov box\\): the recording was not finished"),
    "bad_svg_named.jpg": Refused(f"is an SVG drawing; {KIND}"),
    "bad_text.mp4": Refused(f"is a text file; {KIND}"),
    "bad_truncated_45pct.mp4": Read(
        (524, 524),
        38,
        has_audio=True,
        warns="is cut short: 45% of its bytes are there; its first 38 of 100 frames are read",
        strict="is cut short: its header claims .* bytes",
    ),
    "bad_zero_byte.mp4": Refused(f"is empty; {KIND}"),
    "bt601_full_range.mp4": Read((512, 512), 50, has_audio=False),
    "bt601_limited_range.mp4": Read((512, 512), 50, has_audio=False),
    "bt709_full_range.mp4": Read((512, 512), 50, has_audio=False),
    "bt709_limited_range.mp4": Read((512, 512), 50, has_audio=False),
    "fps_60_duplicated.mp4": Read((524, 524), 180, last_s=179 / 60, has_audio=True),
    "hevc_10bit.mp4": Read(
        (512, 512), 75, format="yuv420p10le", has_audio=True, warns="does not say its transfer function"
    ),
    "interlaced_tff.mp4": Read((512, 512), 45, has_audio=True),
    "many_cuts_small_dark_faces_stage.mp4": Read((640, 360), 275, first_s=None, has_audio=True),
    "mjpeg.mov": Read((512, 512), 38, has_audio=False),
    "no_audio_track.mp4": Read((524, 524), 75, last_s=2.96, has_audio=False),
    "no_face_bottles.mp4": Read((640, 360), 90, first_s=None, has_audio=False),
    "no_face_cartoon_title.mp4": Read((960, 540), 95, first_s=None, has_audio=True),
    "odd_641x479_h264_yuv444.mp4": Read((641, 479), 50, format="yuv444p", has_audio=True),
    "odd_641x479_vp9.webm": Read((641, 479), 50, has_audio=True, first_s=None),
    "portrait_exif_orientation6.jpg": Read((874, 1200), 1, format="rgb24"),
    "prores_proxy.mov": Read(
        (512, 512), 25, format="yuv422p10le", has_audio=False, warns="does not say its transfer function"
    ),
    "rotated90_display_matrix.mp4": Read((524, 524), 75, rotation=90, has_audio=True),
    "single_frame.mp4": Read((524, 524), 1, has_audio=False),
    "two_faces_small.mp4": Read((960, 480), 60, has_audio=False),
    "vfr_jittered.mp4": Read((524, 524), 83, first_s=None, has_audio=True),
    "vp9_opus.webm": Read((512, 512), 90, first_s=None, has_audio=True),
    # files made on the spot
    "edit list": Read((96, 64), 18, last_s=0.68),
    "edit list of fragments": Read((96, 64), 18, last_s=0.68),
    "negative start": Read((96, 64), 24, 0.08, 1.0),  # libav moves the coding order's lead in front of zero
    "negative start, mkv": Read((96, 64), 24, 0.0, 0.92),
    "late start, mp4": Read((96, 64), 24, 3.0, 3.92),
    "late start, mkv": Read((96, 64), 24, 3.0, 3.92),
    "variable rate": Read((96, 64), 24, 0.207, 3.292),
    "missing durations": Read((96, 64), 24, last_s=0.92),
    "no display stamps": Read((96, 64), 24, last_s=0.92),
    "changed resolution": Refused(
        "changes from 96x64 yuv420p to 128x80 yuv420p at frame 12; re-encode it at one size", late=True
    ),
    "attached picture": Read((96, 64), 24, last_s=0.92),
    "two videos": Read(
        (96, 64), 24, last_s=0.92, warns="has 2 video streams: number 2 is used, the first marked default"
    ),
    "cut mp4": Read(
        (96, 64), 16, last_s=0.6, warns="its first 16 of 24 frames are read", strict="is cut short: its header claims"
    ),
    "cut variable rate": Read(
        (96, 64), 16, 0.3, 3.68, warns="its first 16 of 24 frames are read", strict="is cut short: its header claims"
    ),
    "cut fragments": Read(
        (96, 64), 11, 0.08, 0.52, warns="its first 11 frames are read", strict="is cut short: its header claims"
    ),
    "cut mkv": Read(
        (96, 64), 16, last_s=0.6, warns="its first 16 frames are read", strict="is cut short: its header claims"
    ),
    "cut live mkv": Read(
        (96, 64), 16, last_s=0.6, warns="its first 16 frames are read", strict="its last block is damaged or not whole"
    ),
    "cut avi": Read(
        (96, 64), 16, last_s=0.6, warns="its first 16 of 24 frames are read", strict="is cut short: its header claims"
    ),
    "damaged middle": Refused("is damaged after frame \\d+ .*; upload it again", late=True),
    "damaged picture": Refused("is damaged after frame \\d+ .*; upload it again", late=True),
}


def refused(path: Path, expected: Refused) -> None:
    if expected.late:
        probe(path)
    with pytest.raises(MediaError) as caught:
        list(read_frames(path)) if expected.late else probe(path)
    assert re.search(expected.line, str(caught.value))
    assert "\n" not in str(caught.value)
    if not expected.late:
        with pytest.raises(MediaError):
            list(read_frames(path))


def read(path: Path, expected: Read) -> None:
    info = probe(path)
    stamps = []
    for index, frame in enumerate(read_frames(path)):
        assert frame.index == index
        assert (frame.width, frame.height) == expected.size
        assert frame.format == info.format
        stamps.append(frame.time_s)
    assert info.frame_count == len(stamps) == expected.frames
    assert (info.width, info.height, info.rotation) == (*expected.size, expected.rotation)
    assert info.format.name == expected.format
    assert all(np.diff(stamps) > 0)
    assert stamps[-1] - stamps[0] < info.duration_s + 0.01 or info.kind == "image"  # headers are off by a little
    assert expected.first_s is None or stamps[0] == pytest.approx(expected.first_s, abs=1e-3)
    assert expected.last_s is None or stamps[-1] == pytest.approx(expected.last_s, abs=1e-3)
    assert expected.has_audio is None or info.has_audio is expected.has_audio
    if expected.warns is None:
        assert info.warnings == ()
    else:
        assert len(info.warnings) == 1
        assert expected.warns in info.warnings[0]
    if expected.strict is None:
        assert probe(path, strict=True) == info
    else:
        with pytest.raises(MediaError, match=expected.strict):
            probe(path, strict=True)
    late = [frame.index for frame in read_frames(path, start=len(stamps) - 1)]
    assert late == [len(stamps) - 1]  # random access counts as reading in order does


def check(path: Path, expected: Read | Refused) -> None:
    if isinstance(expected, Refused):
        refused(path, expected)
    else:
        read(path, expected)


def test_every_file_of_the_folder_has_its_outcome(media_dir: Path) -> None:
    files = [path for path in sorted((media_dir / "odd").iterdir()) if path.suffix != ".md"]
    assert not {path.name for path in files} - set(TABLE), "a file without a row in the table"
    for path in files:
        check(path, TABLE[path.name])


@pytest.mark.parametrize("name", MADE)
def test_every_odd_clip_has_its_outcome(name: str, tmp_path: Path) -> None:
    check(MADE[name](tmp_path), TABLE[name])


@pytest.mark.parametrize("name", [name for name in MADE if isinstance(TABLE[name], Read)])
def test_time_stamps_of_odd_clips_are_written_as_they_were_read(name: str, tmp_path: Path) -> None:
    path = MADE[name](tmp_path)
    frames = list(read_frames(path))
    out = write_clip(tmp_path / "out.mp4", frames, probe(path))
    written = [frame.time_s for frame in read_frames(out)]
    assert written == pytest.approx([frame.time_s for frame in frames], abs=1e-6)


@pytest.mark.parametrize("name", ["cut mp4", "cut fragments"])
def test_a_cut_clip_is_refused_in_reading_when_nothing_may_be_missing(name: str, tmp_path: Path) -> None:
    with pytest.raises(MediaError, match="cut short"):
        list(read_frames(MADE[name](tmp_path), strict=True))


def test_a_matroska_clip_whose_blocks_are_lost_is_refused(tmp_path: Path) -> None:
    path = lost_blocks(tmp_path)
    assert len(list(read_frames(path))) < FRAMES, "nothing else tells"
    with pytest.raises(MediaError, match=r"is damaged at byte \d+: pictures may be missing; upload it again"):
        probe(path)


def test_zeros_behind_a_matroska_clip_are_no_damage(tmp_path: Path) -> None:
    path = late_start_mkv(tmp_path)
    path.write_bytes(path.read_bytes() + bytes(100))
    assert probe(path, strict=True).warnings == ()


@pytest.mark.parametrize(
    ("made", "words"),
    [(changed_tags, "changes its colour tags"), (changed_fields, "changes from progressive to interlaced")],
)
def test_a_clip_that_changes_what_it_says_of_its_pictures_is_warned_of(
    made: Callable[[Path], Path], words: str, tmp_path: Path
) -> None:
    path, told = made(tmp_path), list[str]()
    assert len(list(read_frames(path, notice=told.append))) == FRAMES
    assert told == [f"it {words} at frame 12: all is read as its first picture"]
    with pytest.raises(MediaError, match=f"{words} at frame 12"):
        list(read_frames(path, strict=True))


def test_pictures_that_lean_on_others_before_a_cut_are_no_damage(tmp_path: Path) -> None:
    path = open_group(tmp_path)
    frames = list(read_frames(path, strict=True))
    assert len(frames) >= 14
    assert list(read_frames(path, start=len(frames) - 3))[-1].pts == frames[-1].pts


def test_a_clip_without_its_tail_is_vectorised_and_rendered_as_far_as_it_goes(media_dir: Path, tmp_path: Path) -> None:
    path = media_dir / "odd" / "bad_truncated_45pct.mp4"
    with pytest.raises(MediaError, match="cut short"):
        pvg.vectorize(path, strict=True)
    with pvg.vectorize(path) as video:
        assert video.frame_count == 38
        pvg.render(video, [pvg.transfer(video, video)], [tmp_path / "out.mp4"], preset="ultrafast")
    info = probe(tmp_path / "out.mp4")
    assert (info.frame_count, info.has_audio) == (38, True)
    assert info.duration_s < 1.7  # the sound ends with the pictures


# 8K


def test_an_8k_clip_and_an_8k_picture_are_within_the_limits(tmp_path: Path) -> None:
    small = np.random.default_rng(2).integers(0, 255, (45, 80, 3), dtype=np.uint8)
    large = np.repeat(np.repeat(small, 96, 0), 96, 1)
    assert large.shape == (4320, 7680, 3)
    assert MediaLimits().max_pixels >= 7680 * 4320
    clip = encode_raw(tmp_path / "8k.mp4", [libav_frame(large)], "libx264", preset="ultrafast")
    write_image(tmp_path / "8k.tiff", large)
    for path in (clip, tmp_path / "8k.tiff"):
        info: MediaInfo = probe(path)
        assert (info.width, info.height, info.frame_count) == (7680, 4320, 1)
    (frame,) = read_frames(clip)
    assert frame.planes[0].shape == (4320, 7680)
    np.testing.assert_array_equal(read_image(tmp_path / "8k.tiff").rgb(), large)
    with pytest.raises(MediaError, match="7680x4320"):
        probe(clip, MediaLimits(max_pixels=7680 * 4320 - 1))
