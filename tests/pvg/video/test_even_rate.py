from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest

from pvg.video import probe
from pvg.video.even_rate import EvenTimes, even_rate_of
from tests.gallery.clips import media_info, pixel_format, rewrite_clip, smooth_frames, write_clip

_MS = Fraction(1, 1000)
_FILM = Fraction(24000, 1001)


def _rounded(rate: Fraction, count: int, first: int = 0) -> list[int]:
    return [round(first + k * 1000 / rate) for k in range(count)]


@pytest.mark.parametrize("rate", [_FILM, Fraction(30), Fraction(30000, 1001), Fraction(60), Fraction(120)])
@pytest.mark.parametrize("first", [0, 21])
def test_the_rate_behind_milliseconds_is_found(rate: Fraction, first: int) -> None:
    stamps = _rounded(rate, 5000, first)
    assert even_rate_of(stamps, _MS, rate) == rate
    assert even_rate_of(stamps[:7] + stamps[12:], _MS, rate) == rate  # frames that a recording has lost
    times = EvenTimes(rate, _MS, first)
    assert [(times.ticks(stamp) - times.ticks(first)) * times.time_base for stamp in stamps] == [
        k / rate for k in range(5000)
    ]


@pytest.mark.parametrize(
    ("stamps", "time_base", "rate"),
    [
        (_rounded(Fraction(25), 100), _MS, Fraction(25)),  # exact as they are
        (_rounded(_FILM, 100), Fraction(1, 90000), _FILM),  # a container that does not round so far
        (_rounded(Fraction(2398, 100), 5000), _MS, Fraction(24)),  # of another rate
        ([0, 33, 67, 103, 133], _MS, Fraction(30)),  # one is 3 ms late
        ([0, 33, 34, 67], _MS, Fraction(30)),  # two of one frame
        (_rounded(Fraction(240), 100), _MS, Fraction(240)),  # too close to tell
        ([], _MS, _FILM),
    ],
)
def test_other_time_stamps_are_of_no_even_rate(stamps: list[int], time_base: Fraction, rate: Fraction) -> None:
    assert even_rate_of(stamps, time_base, rate) is None


def test_a_stamp_that_is_not_of_the_rate_stays_when_it_is() -> None:
    times = EvenTimes(Fraction(30), _MS, 21)
    assert times.ticks(21 + 15) * times.time_base == Fraction(36, 1000)


def _steps(path: Path) -> list[Fraction]:
    with av.open(str(path)) as clip:
        stamps = sorted(packet.pts * packet.time_base for packet in clip.demux(video=0) if packet.pts is not None)
    return [later - stamp for stamp, later in pairwise(stamps)]


@pytest.mark.parametrize(("rate", "suffix"), [(_FILM, ".mp4"), (Fraction(60), ".mov"), (Fraction(30000, 1001), ".mov")])
def test_an_even_rate_stays_even_out_of_matroska(rate: Fraction, suffix: str, tmp_path: Path) -> None:
    layout, base = pixel_format(), 1 / rate
    frames = [replace(frame, pts=k + 3, duration=1) for k, frame in enumerate(smooth_frames(20, layout))]
    source = write_clip(tmp_path / "i.mkv", frames, media_info(layout, frame_rate=rate, time_base=base))
    assert len(set(_steps(source))) > 1
    assert probe(source).even_rate == rate
    target = rewrite_clip(source, tmp_path / f"o{suffix}")
    assert set(_steps(target)) == {1 / rate}
    info = probe(target)
    assert (info.frame_rate, info.even_rate) == (rate, None)
    assert info.duration_s == pytest.approx(float(20 / rate), abs=1e-4)
    again = rewrite_clip(source, tmp_path / "o.mkv")
    assert _steps(again) == _steps(source)


def test_a_clip_that_begins_late_and_has_lost_frames_keeps_its_rate(tmp_path: Path) -> None:
    """Its header's length tells nothing, and with that went its rate: it became a variable one."""
    layout, base, times = pixel_format(), 1 / _FILM, [*range(120, 128), *range(132, 144)]
    frames = [replace(frame, pts=pts, duration=1) for frame, pts in zip(smooth_frames(20, layout), times, strict=True)]
    source = write_clip(tmp_path / "i.mkv", frames, media_info(layout, frame_rate=_FILM, time_base=base))
    info = probe(source)
    assert (info.even_rate, info.duration_s) == (_FILM, pytest.approx(float(24 / _FILM), abs=0.02))
    assert set(_steps(rewrite_clip(source, tmp_path / "o.mp4"))) == {1 / _FILM, 5 / _FILM}


def test_a_variable_rate_out_of_matroska_keeps_its_times(tmp_path: Path) -> None:
    steps = np.random.default_rng(2).integers(20, 60, 20)
    frames = [
        replace(frame, pts=int(pts), duration=int(step))
        for frame, pts, step in zip(smooth_frames(20, pixel_format()), np.cumsum(steps), steps, strict=True)
    ]
    source = write_clip(tmp_path / "i.mkv", frames, media_info(pixel_format(), time_base=_MS))
    assert probe(source).even_rate is None
    assert _steps(rewrite_clip(source, tmp_path / "o.mp4")) == [Fraction(int(step), 1000) for step in steps[1:]]
