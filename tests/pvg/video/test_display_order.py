from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from pvg.video import frame_at, key_pictures, read_frames
from tests.gallery import odd_clips
from tests.gallery.clips import encode_raw, libav_frame, short_clip
from tests.gallery.pictures import colorful


def test_key_pictures_are_counted_in_display_order(tmp_path: Path) -> None:
    clip = short_clip(tmp_path / "clip.mp4", 30)
    keys = key_pictures(clip)
    assert keys is not None
    whole = [frame.planes[0].copy() for frame in read_frames(clip)]
    for key in keys:
        (frame,) = read_frames(clip, start=key, stop=key + 1)
        np.testing.assert_array_equal(frame.planes[0], whole[key])


@pytest.mark.parametrize("make", [odd_clips.variable_rate, odd_clips.late_start, odd_clips.negative_start])
def test_a_time_names_the_frame_that_is_shown_then(tmp_path: Path, make: object) -> None:
    clip = make(tmp_path)  # type: ignore[operator]
    times = [frame.time_s for frame in read_frames(clip)]
    for index, time_s in enumerate(times):
        assert frame_at(clip, time_s - times[0]) == index
    assert frame_at(clip, 1e6) == len(times) - 1


def test_another_clip_in_the_place_of_one_has_its_own_keys(tmp_path: Path) -> None:
    """As one that was copied there with its time, and happens to be as long."""
    pictures = [libav_frame(colorful(9, (160, 96)))] * 30
    here, other = (encode_raw(tmp_path / f"{g}.mp4", pictures, "libx264", g=g) for g in ("10", "15"))
    longest = max(path.stat().st_size for path in (here, other))
    for path in (here, other):
        lacks = longest + 8 - path.stat().st_size
        with path.open("ab") as file:
            file.write(lacks.to_bytes(4, "big") + b"free" + bytes(lacks - 8))
        os.utime(path, ns=(1, 1))
    assert key_pictures(here) == (0, 10, 20)
    other.replace(here)
    assert key_pictures(here) == (0, 15)


def test_packets_that_do_not_fit_the_frames_known_tell_nothing(tmp_path: Path) -> None:
    clip = encode_raw(tmp_path / "clip.mp4", [libav_frame(colorful(9, (160, 96)))] * 30, "libx264", g="10")
    assert key_pictures(clip) == key_pictures(clip, frame_count=30) == (0, 10, 20)
    assert frame_at(clip, 0.5, frame_count=30) == frame_at(clip, 0.5) is not None
    assert key_pictures(clip, frame_count=29) is None
    assert frame_at(clip, 0.5, frame_count=29) is None
