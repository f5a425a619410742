from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pvg
from pvg.errors import MediaError
from pvg.rendering import PART_S, Renderer, join_parts, part_bounds, render_part
from pvg.rendering.canvas import stored_frames
from pvg.video import VideoWriter, probe, read_frames, read_streams
from tests.gallery.clips import add_tone, sound_packets

_BOUNDS = (0, 11, 20, 40)


def _parts(
    video: pvg.VectorVideo, looks: list[pvg.Look], folder: Path, bounds: tuple[int, ...] = _BOUNDS, **options: Any
) -> list[list[Path]]:
    """The part files of each look, the last part drawn first."""
    folder.mkdir(exist_ok=True)
    files = [[folder / f"{k}-{start}.part" for start in bounds[:-1]] for k in range(len(looks))]
    for number, (start, stop) in reversed(list(enumerate(pairwise(bounds)))):
        render_part(video, looks, [of_look[number] for of_look in files], start=start, stop=stop, **options)
    return files


def _pixels(path: Path) -> list[bytes]:
    return [b"".join(plane.tobytes() for plane in frame.planes) for frame in read_frames(path)]


@pytest.mark.parametrize("frame_rate", [1, 12.5, 23.976, 25, 29.97, 60])
@pytest.mark.parametrize("frame_count", [1, 2, 9, 249, 250, 499, 500, 501, 12345])
def test_parts_are_as_many_as_whole_ones_fit_and_as_equal_as_frames_allow(frame_count: int, frame_rate: float) -> None:
    bounds = part_bounds(frame_count, frame_rate)
    assert (bounds[0], bounds[-1]) == (0, frame_count)
    lengths = [stop - start for start, stop in pairwise(bounds)]
    whole = max(8, round(PART_S * frame_rate), -(-frame_count // 480))
    assert len(lengths) == max(1, frame_count // whole)
    assert max(lengths) - min(lengths) <= 1
    assert len(lengths) == 1 or whole <= min(lengths) <= max(lengths) < 2 * whole


def test_bounds_depend_on_nothing_but_count_and_rate() -> None:
    assert part_bounds(40, None) == (0, 40)
    assert part_bounds(100, 25, part_s=1.0) == (0, 25, 50, 75, 100)
    assert part_bounds(100, 0.5) == part_bounds(100, 0.1)  # never fewer than an encoder reorders
    probed = 26_450_040 / 1_000_000
    assert part_bounds(2000, probed) == part_bounds(2000, round(probed, 3))


def test_a_clip_of_parts_has_their_pixels_and_the_stamps_of_one_drawn_whole(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    looks = [pvg.transfer(video, reference) for reference in (dark_reference, pale_reference)]
    drawn = list(stored_frames(video))
    files = _parts(video, looks, tmp_path / "parts", container="mkv", codec="ffv1")
    joined = [tmp_path / "dark.mkv", tmp_path / "pale.mkv"]
    assert join_parts(video, files, joined, codec="ffv1") == [(), ()]
    renderer = Renderer(video, looks)
    clips = [list(read_frames(path)) for path in joined]
    assert [len(frames) for frames in clips] == [video.frame_count] * 2
    for k in range(0, video.frame_count, 3):
        for frames, expected in zip(clips, renderer.draw(drawn[k]), strict=True):
            for plane, wanted in zip(frames[k].planes, expected.planes, strict=True):
                np.testing.assert_array_equal(plane, wanted)
    for codec in ("h264", "hevc"):
        options: dict[str, Any] = {"codec": codec, "preset": "ultrafast"}
        paths = [tmp_path / f"{codec}.mp4"]
        coded = _parts(video, looks[:1], tmp_path / codec, container="mp4", **options)
        lines = join_parts(video, coded, paths, **options)
        assert lines == pvg.render(video, looks[:1], [tmp_path / "whole.mp4"], **options)
        whole, seen = probe(tmp_path / "whole.mp4"), probe(paths[0])
        assert seen == whole
        stamps = [[frame.pts for frame in read_frames(path)] for path in (tmp_path / "whole.mp4", paths[0])]
        assert stamps[0] == stamps[1] == [frame.pts for frame in drawn]


def _draw_elsewhere(asset: Path, source: Path, reference: Path, folder: Path) -> None:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # a machine of one core
    with pvg.VectorVideo(asset, source) as video, pvg.vectorize(reference, reference=True) as dark:
        look = pvg.transfer(video, dark)
        files = _parts(video, [look], folder, container="mp4", preset="ultrafast")
        join_parts(video, files, [folder / "out.mp4"], preset="ultrafast")


def test_parts_drawn_twice_or_in_another_process_give_the_same_bytes(
    video: pvg.VectorVideo, short_clip: Path, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(video, dark_reference)
    here, alone, there = tmp_path / "here", tmp_path / "alone", tmp_path / "there"
    (files,) = _parts(video, [look], here, container="mp4", preset="ultrafast")
    alone.mkdir()
    for path, (start, stop) in zip(files, pairwise(_BOUNDS), strict=True):
        render_part(video, [look], [alone / path.name], start=start, stop=stop, container="mp4", preset="ultrafast")
    join_parts(video, [files], [here / "out.mp4"], preset="ultrafast")
    process = multiprocessing.get_context("spawn").Process(
        target=_draw_elsewhere, args=(video.path, short_clip, dark_reference.require_source(), there)
    )
    process.start()
    process.join()
    assert process.exitcode == 0
    for path in files:
        assert path.read_bytes() == (alone / path.name).read_bytes() == (there / path.name).read_bytes()
    assert (here / "out.mp4").read_bytes() == (there / "out.mp4").read_bytes()


@pytest.fixture(scope="module")
def uneven(short_clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[pvg.VectorVideo]:
    """24 frames with uneven steps, the first of them late, and sound that begins before it."""
    folder = tmp_path_factory.mktemp("uneven")
    info = probe(short_clip)
    assert info.time_base is not None
    step = round(0.04 / info.time_base)
    stamps = 5 * step + np.cumsum(np.random.default_rng(5).integers(step // 3, 3 * step, 24))
    with VideoWriter(folder / "silent.mp4", info, info.format, crf=12) as writer:
        for frame in read_frames(short_clip, stop=24):
            writer.write(replace(frame, pts=int(stamps[frame.index]), duration=step))
    source = add_tone(folder / "silent.mp4", 2.0, 0.5, folder / "clip.mp4")
    with pvg.vectorize(source, asset=folder / "clip.pvg") as vectorized:
        yield vectorized


def test_an_uneven_clip_keeps_its_stamps_and_its_sound(uneven: pvg.VectorVideo, tmp_path: Path) -> None:
    own, source = [pvg.transfer(uneven, uneven)], uneven.require_source()
    before = [frame.pts for frame in read_frames(source)]
    assert before[0] > 0
    assert len(set(np.diff(before))) > 5
    for container, codec in (("mp4", "h264"), ("mov", "hevc"), ("mkv", "h264")):
        options: dict[str, Any] = {"container": container, "codec": codec, "preset": "veryfast"}
        whole, out = tmp_path / f"whole.{container}", tmp_path / f"out.{container}"
        files = _parts(uneven, own, tmp_path / container, (0, 8, 16, 24), **options)
        lines = join_parts(uneven, files, [out], **options)
        assert lines == pvg.render(uneven, own, [whole], **options)
        assert [frame.time_s for frame in read_frames(out)] == [frame.time_s for frame in read_frames(whole)]
        assert sound_packets(out) == sound_packets(whole)
        assert read_streams(out) == read_streams(whole)
        if container != "mkv":
            assert [frame.pts for frame in read_frames(out)] == before
            assert sound_packets(out) == sound_packets(source)
    silent = tmp_path / "silent.mkv"
    join_parts(uneven, files, [silent], codec="h264", preset="veryfast", audio="none")
    assert not probe(silent).has_audio
    assert _pixels(silent) == _pixels(tmp_path / "out.mkv")


def test_an_unfit_join_or_an_aborted_part_leaves_no_file(
    video: pvg.VectorVideo, uneven: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look, other, out = pvg.transfer(video, dark_reference), pvg.transfer(uneven, dark_reference), tmp_path / "out.mp4"
    (files,) = _parts(video, [look], tmp_path / "parts", container="mp4", preset="ultrafast")
    (foreign,) = _parts(uneven, [other], tmp_path / "foreign", (0, 11, 24), container="mp4", preset="ultrafast")
    for given in (files[:2], files[::-1], [foreign[0], *files[1:]], [*files[:2], tmp_path / "lost.part"]):
        with pytest.raises(MediaError):
            join_parts(video, [files, given], [out, tmp_path / "two.mp4"], preset="ultrafast")
    with pytest.raises(MediaError, match="another manner"):
        join_parts(video, [files], [out], preset="slow")

    class CanceledError(Exception):
        pass

    seen: list[tuple[str, int, int]] = []

    def cancel(stage: str, done: int, total: int) -> None:
        seen.append((stage, done, total))
        if done == 5:
            raise CanceledError

    with pytest.raises(CanceledError):
        render_part(
            video,
            [look],
            [tmp_path / "a.part"],
            start=11,
            stop=20,
            container="mp4",
            preset="ultrafast",
            progress=cancel,
        )
    assert seen == [("render", k, 9) for k in range(1, 6)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["foreign", "parts"]


def test_what_has_no_parts_is_said(video: pvg.VectorVideo, group: pvg.VectorVideo, tmp_path: Path) -> None:
    own, path = [pvg.transfer(video, video)], tmp_path / "a.part"
    for start, stop in ((0, 41), (5, 5), (-1, 4), (40, 41)):
        with pytest.raises(ValueError, match="no frames of a clip of 40"):
            render_part(video, own, [path], start=start, stop=stop, container="mp4")
    with pytest.raises(ValueError, match=r"stop must be a whole number, not 8\.0"):
        render_part(video, own, [path], start=0, stop=8.0, container="mp4")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="render it whole"):
        render_part(video, own, [path], start=0, stop=9, container="nut")
    with pytest.raises(ValueError, match="render it whole"):
        render_part(group, [pvg.transfer(group, group)], [path], start=0, stop=1, container="mp4")
    with pytest.raises(ValueError, match="paths"):
        join_parts(video, [[path]], [])
    assert list(tmp_path.iterdir()) == []


def test_where_a_part_is_may_be_numbers_of_numpy(video: pvg.VectorVideo, tmp_path: Path) -> None:
    own, plain, of_numpy = [pvg.transfer(video, video)], tmp_path / "plain.part", tmp_path / "numpy.part"
    render_part(video, own, [plain], start=4, stop=7, container="mp4")
    render_part(video, own, [of_numpy], start=np.int64(4), stop=np.int64(7), container="mp4")  # type: ignore[arg-type]
    assert plain.read_bytes() == of_numpy.read_bytes()


def test_parts_replace_nothing_that_they_are_made_from(
    video: pvg.VectorVideo, group: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    source = video.require_source()
    before = source.read_bytes()
    where: dict[str, Any] = {"container": "mp4", "start": 0, "stop": 20}
    look = pvg.transfer(video, dark_reference)
    with pytest.raises(ValueError, match="would be replaced"):
        render_part(video, [look], [source], **where)
    with pytest.raises(ValueError, match="of another clip"):
        render_part(video, [pvg.transfer(group, dark_reference)], [tmp_path / "0.part"], **where)
    with pytest.raises(ValueError, match=r"crf of H\.264 is a whole number from 0 to 51"):
        render_part(video, [look], [tmp_path / "0.part"], crf=60, **where)
    part = tmp_path / "part.mp4"
    part.write_bytes(b"a part")
    with pytest.raises(ValueError, match=r"part\.mp4 would be replaced"):
        join_parts(video, [[part]], [part])
    assert source.read_bytes() == before
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"a part"]
