"""Clips beyond the usual limits: those that they were vectorised with hold whenever they are read again."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import pytest

import pvg
from pvg.errors import MediaError
from pvg.rendering import Stills, join_parts, render_part
from pvg.video import read_frames
from scripts.samples import Samples
from tests.gallery.clips import encode_raw, libav_frame

_FRAMES = 4
_LIMITS = pvg.MediaLimits(max_frame_rate=500.0)


@pytest.fixture(scope="module")
def fast(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of 300 frames a second; 240 are usual."""
    pictures = [libav_frame(frame.rgb()) for frame in read_frames(samples.woman_clip, start=20, stop=20 + _FRAMES)]
    return encode_raw(tmp_path_factory.mktemp("fast") / "fast.mp4", pictures, "libx264", rate=300)


@pytest.fixture(scope="module")
def video(fast: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[pvg.VectorVideo]:
    asset = tmp_path_factory.mktemp("asset") / "fast.pvg"
    with pvg.vectorize(fast, asset=asset, limits=_LIMITS) as vectorized:
        yield vectorized


@pytest.fixture(scope="module")
def look(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> pvg.Look:
    return pvg.transfer(video, dark_reference)


def test_a_clip_is_drawn_within_the_limits_that_it_was_vectorised_with(
    video: pvg.VectorVideo, look: pvg.Look, tmp_path: Path
) -> None:
    pvg.render(video, [look], [tmp_path / "out.mp4"])
    pvg.export(video, look, tmp_path / "look", parts=["cube"])
    assert pvg.layer(video, 1, "matte").size
    part = tmp_path / "clip.part"
    render_part(video, [look], [part], start=0, stop=_FRAMES, container="mp4")
    join_parts(video, [[part]], [tmp_path / "joined.mp4"])
    assert sum(1 for _ in read_frames(tmp_path / "joined.mp4", limits=_LIMITS)) == _FRAMES


def test_its_single_pictures_are_seen(video: pvg.VectorVideo) -> None:
    stills = Stills(video)
    assert stills.at_time(2 / 300) == 2
    assert stills.drawn(None, stills.usual_frame()).shape == (360, 640, 3)


def test_pictures_by_a_pipe_are_held_to_its_limits(video: pvg.VectorVideo, look: pvg.Look) -> None:
    given, taken = io.BytesIO(), io.BytesIO()
    pvg.render(video, [look], [given], container="y4m")
    given.seek(0)
    pvg.render(video, [look], [taken], container="y4m", pictures=given)
    small = pvg.open_asset(video.path, video.source, limits=pvg.MediaLimits(max_frame_rate=500.0, max_pixels=1000))
    with small, pytest.raises(MediaError, match="at most 1000"):
        pvg.render(small, [look], [io.BytesIO()], pictures=io.BytesIO(given.getvalue()))


def test_an_asset_that_is_opened_again_is_told_its_limits(
    video: pvg.VectorVideo, look: pvg.Look, tmp_path: Path
) -> None:
    with (
        pvg.open_asset(video.path, video.source) as usual,
        pytest.raises(MediaError, match=r"300.00 frames a second; at most 240"),
    ):
        pvg.render(usual, [look], [tmp_path / "out.mp4"])
    with pvg.open_asset(video.path, video.source, limits=_LIMITS) as opened:
        pvg.render(opened, [look], [tmp_path / "out.mp4"])
