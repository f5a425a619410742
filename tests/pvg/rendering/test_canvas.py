"""Looks drawn on pictures that come by a pipe, and given to one."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pvg
from pvg.errors import MediaError
from pvg.rendering import canvas
from pvg.rendering.canvas import piped_canvas
from pvg.video import PipeReader, VideoWriter, make_plan, probe, read_frames, read_streams
from scripts.samples import Samples
from tests.gallery.clips import add_tone, encode_raw, libav_frame
from tests.gallery.pictures import colorful

_FRAMES = 5


@pytest.fixture(scope="module")
def clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Iterator[pvg.VectorVideo]:
    """It begins late, and its frames last longer and longer."""
    path, info = tmp_path_factory.mktemp("canvas") / "clip.mp4", probe(samples.woman_clip)
    assert info.time_base is not None
    ticks = round(Fraction(1, 50) / info.time_base)
    with VideoWriter(path, info, info.format, crf=12) as writer:
        for frame in read_frames(samples.woman_clip, stop=_FRAMES):
            writer.write(replace(frame, pts=(frame.index**2 + 9) * ticks, duration=(2 * frame.index + 1) * ticks))
    with pvg.vectorize(path) as video:
        yield video


@pytest.fixture(scope="module")
def look(clip: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> pvg.Look:
    return pvg.transfer(clip, dark_reference)


def test_a_pipe_gets_and_gives_the_same_pictures_as_files(
    clip: pvg.VectorVideo, look: pvg.Look, tmp_path: Path
) -> None:
    assert pvg.render(clip, [look], [tmp_path / "out.mkv"], codec="ffv1") == [()]
    expected = list(read_frames(tmp_path / "out.mkv"))
    plain = pvg.transfer(clip, clip, strength=0.0)
    for container in ("nut", "y4m"):
        given, taken = io.BytesIO(), io.BytesIO()
        pvg.render(clip, [plain], [given], container=container)
        given.seek(0)
        lines = pvg.render(clip, [look], [taken], container=container, pictures=given)
        assert [line.split(" ")[:2] for line in lines[0]] == ([["time", "stamps"]] if container == "y4m" else [])
        taken.seek(0)
        with PipeReader(taken, (1, 1)) as read:
            seen = list(read.frames)
        for frame, other in zip(seen, expected, strict=True):
            for plane, wanted in zip(frame.planes, other.planes, strict=True):
                np.testing.assert_array_equal(plane, wanted)


def test_pictures_of_another_number_or_size_are_refused(clip: pvg.VectorVideo, look: pvg.Look, tmp_path: Path) -> None:
    whole = io.BytesIO()
    pvg.render(clip, [look], [whole], container="y4m")
    content = whole.getvalue()
    head, frames = content.split(b"\n", 1)
    size = len(frames) // _FRAMES
    for changed, words in (
        (content[: len(content) - size], f"ends after {_FRAMES - 1} frames"),
        (content + frames[:size], f"more frames than the {_FRAMES}"),
        (head.replace(b" H", b" H1") + b"\n" + frames, "is of a clip of"),
    ):
        with pytest.raises(MediaError, match=words):
            pvg.render(clip, [look], [tmp_path / "out.mp4"], pictures=io.BytesIO(changed))
    assert list(tmp_path.iterdir()) == []


def _plain(path: Path) -> Any:
    """A clip that nobody vectorised."""
    info = probe(path)
    return SimpleNamespace(
        path=path,
        source=path,
        require_source=lambda: path,
        media=info,
        settings={"input_color": "auto"},
        limits=pvg.MediaLimits(),
        frame_count=info.frame_count,
    )


def test_pictures_that_nut_moves_because_sound_begins_before_zero_stay_beside_it(tmp_path: Path) -> None:
    """As AAC's does, by what its decoder needs."""
    raw = [libav_frame(np.roll(colorful(1, (96, 64)), k, 1)) for k in range(_FRAMES)]
    path = add_tone(encode_raw(tmp_path / "silent.mp4", raw, "libx264"), 1.0, 0.1, tmp_path / "clip.mp4")
    pipe, video = io.BytesIO(), _plain(path)
    plan = make_plan(video.media, container="nut", source=path, streams=read_streams(path))
    with VideoWriter(pipe, video.media, video.media.format, plan=plan) as writer:
        for frame in read_frames(path):
            writer.write(frame)
    with PipeReader(io.BytesIO(pipe.getvalue())) as moved:
        assert next(moved.frames).time_s == pytest.approx(1024 / 44100, abs=3e-3), "NUT has no time before zero"
    with piped_canvas(video, io.BytesIO(pipe.getvalue())) as piped:
        times = [frame.time_s for frame in piped.frames()]
    assert times == [frame.time_s for frame in read_frames(path)]


def test_luma_and_chroma_by_a_pipe_are_not_read_as_a_clip_of_red_green_and_blue_is_coded(tmp_path: Path) -> None:
    """Its matrix and its full range are no Y'CbCr picture's."""
    path = encode_raw(tmp_path / "rgb.mkv", [libav_frame(colorful(1, (96, 64)), "bgr0")], "ffv1")
    video = _plain(path)
    assert video.media.format.is_rgb
    pictures = io.BytesIO(b"YUV4MPEG2 W96 H64 F25:1\nFRAME\n" + bytes(96 * 64 * 3 // 2))
    with piped_canvas(video, pictures) as piped:
        (frame,) = piped.frames()
    assert (frame.format.luma_weights, frame.format.full_range) == ((0.299, 0.114), False)


def test_a_pipe_holds_what_it_can(clip: pvg.VectorVideo, look: pvg.Look, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be written to a pipe"):
        pvg.render(clip, [look], [io.BytesIO()], container="mp4")
    with pytest.raises(ValueError, match="is not named as mov is"):
        pvg.render(clip, [look], [tmp_path / "out.mp4"], container="mov")
    with pytest.raises(ValueError, match="has no crf"):
        pvg.render(clip, [look], [io.BytesIO()], crf=20)


@pytest.mark.parametrize(("said", "fields"), [(b" Ip", None), (b"", "tff"), (b" Ib", "bff")])
def test_a_pipe_that_says_it_is_progressive_is_so_though_its_clip_was_interlaced(
    clip: pvg.VectorVideo, look: pvg.Look, monkeypatch: pytest.MonkeyPatch, said: bytes, fields: str | None
) -> None:
    whole = io.BytesIO()
    pvg.render(clip, [look], [whole], container="y4m")
    assert b" Ip " in whole.getvalue()[:200]
    read = canvas.read_streams
    monkeypatch.setattr(canvas, "read_streams", lambda *given: replace(read(*given), fields="tff"))
    with canvas.piped_canvas(clip, io.BytesIO(whole.getvalue().replace(b" Ip", said, 1))) as found:
        assert found.streams.fields == fields


def test_alpha_comes_by_a_pipe(clip: pvg.VectorVideo, look: pvg.Look, tmp_path: Path) -> None:
    source, pipe = clip.require_source(), io.BytesIO()
    info = replace(probe(source), has_alpha=True)
    with VideoWriter(pipe, info, info.format, container="nut") as writer:
        for frame in read_frames(source):
            writer.write(replace(frame, alpha=frame.planes[0]))
    pipe.seek(0)
    pvg.render(clip, [look], [tmp_path / "out.mkv"], codec="ffv1", pictures=pipe)
    for drawn, frame in zip(read_frames(tmp_path / "out.mkv"), read_frames(source), strict=True):
        np.testing.assert_array_equal(drawn.alpha, frame.planes[0])


@pytest.mark.parametrize("container", ["nut", "y4m"])
def test_alpha_of_a_clip_that_does_not_come_by_the_pipe_is_said_to_be_missing(
    clip: pvg.VectorVideo, look: pvg.Look, monkeypatch: pytest.MonkeyPatch, container: str
) -> None:
    pipe = io.BytesIO()
    pvg.render(clip, [look], [pipe], container=container)
    pipe.seek(0)
    known = canvas.probe
    monkeypatch.setattr(canvas, "probe", lambda *given, **options: replace(known(*given, **options), has_alpha=True))
    with canvas.piped_canvas(clip, pipe) as found:
        assert not found.info.has_alpha
        assert found.missing == ("alpha does not come by the pipe",)


@pytest.mark.parametrize("container", ["nut", "y4m"])
def test_pictures_by_a_pipe_are_shown_when_the_clips_are(
    clip: pvg.VectorVideo, look: pvg.Look, tmp_path: Path, container: str
) -> None:
    """YUV4MPEG2 has no time stamps: beside the clip's sound those of its own pictures hold."""
    pipe = io.BytesIO()
    pvg.render(clip, [look], [pipe], container=container)
    pipe.seek(0)
    pvg.render(clip, [look], [tmp_path / "out.mp4"], pictures=pipe)
    times = [frame.time_s for frame in read_frames(tmp_path / "out.mp4")]
    assert times == pytest.approx([(k**2 + 9) / 50 for k in range(_FRAMES)], abs=2e-3)


def test_time_stamps_that_neither_pipe_nor_clip_tell_are_said_to_be_missing(
    clip: pvg.VectorVideo, look: pvg.Look, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe = io.BytesIO()
    pvg.render(clip, [look], [pipe], container="y4m")
    monkeypatch.setattr(canvas, "display_order", lambda *_: None)
    with canvas.piped_canvas(clip, io.BytesIO(pipe.getvalue())) as found:
        assert [line for line in found.missing if line.startswith("time stamps do not come by the pipe")]
        assert [frame.pts for frame in found.frames()] == list(range(_FRAMES))
    monkeypatch.setattr(clip, "source", None)
    with canvas.piped_canvas(clip, io.BytesIO(pipe.getvalue())) as found:
        assert [line for line in found.missing if line.startswith("sound, tags and time stamps do not come")]
