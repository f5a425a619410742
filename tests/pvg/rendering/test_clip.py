from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pvg
from pvg.rendering.clip import Renderer, source_frame
from pvg.video import probe, read_frames
from tests.conftest import cut_clip


def test_render_writes_every_look_with_the_clips_own_time_stamps(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    looks = [pvg.transfer(video, reference) for reference in (dark_reference, pale_reference)]
    paths = [tmp_path / "dark.mp4", tmp_path / "pale.mp4"]
    seen: list[tuple[str, int, int]] = []
    pvg.render(video, looks, paths, crf=10, progress=lambda *report: seen.append(report))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dark.mp4", "pale.mp4"]
    assert seen == [("render", i + 1, video.frame_count) for i in range(video.frame_count)]
    source = [frame.pts for frame in read_frames(video.require_source())]
    info = probe(video.require_source())
    for look, path in zip(looks, paths, strict=True):
        written = list(read_frames(path))
        assert probe(path).time_base == info.time_base
        assert [frame.pts for frame in written] == source
        error = written[20].rgb().astype(float) - pvg.render_frame(video, look, 20)
        assert np.abs(error).mean() < 2.0
    dark, pale = (next(iter(read_frames(path, start=20, stop=21))).rgb().astype(float) for path in paths)
    assert np.abs(dark - pale).mean() > 3.0


def test_an_aborted_render_leaves_no_file(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    class CanceledError(Exception):
        pass

    def cancel(stage: str, done: int, total: int) -> None:
        if done == 5:
            raise CanceledError

    with pytest.raises(CanceledError):
        pvg.render(video, [pvg.transfer(video, dark_reference)], [tmp_path / "out.mp4"], progress=cancel)
    assert list(tmp_path.iterdir()) == []


def test_two_looks_cannot_share_a_path(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    look = pvg.transfer(video, dark_reference)
    with pytest.raises(ValueError, match="same path"):
        pvg.render(video, [look, look], [tmp_path / "a.mp4", tmp_path / "a.mp4"])
    with pytest.raises(ValueError, match="paths"):
        pvg.render(video, [look, look], [tmp_path / "a.mp4"])


def test_a_look_asked_for_twice_is_drawn_twice_alike(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    look = pvg.transfer(video, dark_reference)
    one, two = Renderer(video, [look, look]).draw(source_frame(video, 3))
    (alone,) = Renderer(video, [look]).draw(source_frame(video, 3))
    np.testing.assert_array_equal(one.planes[0], two.planes[0])
    np.testing.assert_array_equal(one.planes[0], alone.planes[0])


def test_an_image_is_rendered_as_an_image(samples: object, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    portrait: Path = samples.portrait  # type: ignore[attr-defined]
    with pvg.vectorize(portrait) as image:
        assert image.media.kind == "image"
        look = pvg.transfer(image, dark_reference)
        pvg.render(image, [look], [tmp_path / "out.png"])
        (frame,) = read_frames(tmp_path / "out.png")
        np.testing.assert_array_equal(frame.rgb(), pvg.render_frame(image, look, 0))
        own = pvg.render_frame(image, pvg.transfer(image, image), 0)
        np.testing.assert_array_equal(own, pvg.render_frame(image, None, 0))


def test_swap_gives_each_the_others_colours(video: pvg.VectorVideo, samples: object, tmp_path: Path) -> None:
    with pvg.vectorize(samples.dark_portrait) as image:  # type: ignore[attr-defined]
        pvg.swap(video, image, [tmp_path / "a.mp4", tmp_path / "b.png"], crf=10)
        key, other = video.records[0].key_frames[0], image.records[0].key_frames[0]
        expected = pvg.render_frame(image, pvg.transfer(image, video), 0)
        (swapped,) = read_frames(tmp_path / "b.png")
        np.testing.assert_array_equal(swapped.rgb(), expected)
        gap = np.linalg.norm(key.colors.mean(axis=0) - other.colors.mean(axis=0))
        assert gap > 20
        assert probe(tmp_path / "a.mp4").frame_count == video.frame_count


def test_a_reference_asset_cannot_be_rendered(samples: object, tmp_path: Path) -> None:
    clip = cut_clip(samples.woman_clip, tmp_path / "clip.mp4", 0, 12)  # type: ignore[attr-defined]
    with pvg.vectorize(clip, reference=True) as reference:
        assert reference.media.kind == "video"
        look = pvg.transfer(reference, reference)
        with pytest.raises(pvg.AssetError, match="reference"):
            pvg.render(reference, [look], [tmp_path / "out.mp4"])


def test_another_clip_is_refused(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    other = tmp_path / "other.mp4"
    other.write_bytes(video.require_source().read_bytes() + b"\0")
    with pvg.open_asset(video.path, other) as opened:
        look = pvg.transfer(opened, dark_reference)
        with pytest.raises(pvg.AssetError, match="not the clip"):
            pvg.render(opened, [look], [tmp_path / "out.mp4"])


def test_the_papers_chain_renders_near_the_table(
    short_clip: Path, video: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    """Early in a clip the chain has drifted little: both give the same picture but for some levels."""
    with pvg.vectorize(short_clip, matching="chain") as chained:
        look, table = pvg.transfer(chained, dark_reference), pvg.transfer(video, dark_reference)
        ours, theirs = (pvg.render_frame(v, k, 15).astype(float) for v, k in ((chained, look), (video, table)))
        source = pvg.render_frame(video, None, 15).astype(float)
        assert np.abs(ours - theirs).mean() < 0.15 * np.abs(theirs - source).mean()
        own = pvg.transfer(chained, chained)
        np.testing.assert_array_equal(pvg.render_frame(chained, own, 15), pvg.render_frame(chained, None, 15))


def test_a_frame_drawn_alone_is_the_frame_of_the_clip(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    look = pvg.transfer(video, dark_reference)
    through = Renderer(video, [look])
    for frame in read_frames(video.require_source(), stop=12):
        (drawn,) = through.draw(frame)
        if frame.index in (0, 11):
            np.testing.assert_array_equal(drawn.rgb(), pvg.render_frame(video, look, frame.index))


def test_a_look_for_one_face_leaves_the_other_faces_alone(samples: object, dark_reference: pvg.VectorVideo) -> None:
    with pvg.vectorize(samples.several_faces) as image:  # type: ignore[attr-defined]
        assert len(image.faces) >= 2
        before = pvg.render_frame(image, None, 0).astype(int)
        after = pvg.render_frame(image, pvg.transfer(image, dark_reference, faces=[0]), 0).astype(int)
        change = np.abs(after - before).max(axis=2)
        for face in image.faces:
            data = image.face_frame(face.index, 0)
            assert data is not None
            x, y = np.rint(data.points[46]).astype(int)  # the tip of the nose
            there = change[y - 3 : y + 4, x - 3 : x + 4]
            assert there.max() > 5 if face.index == 0 else there.max() == 0


def test_more_looks_than_are_drawn_at_once_take_further_passes(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    strengths = (0.0, 0.25, 0.5, 0.75, 1.0)
    looks = [pvg.transfer(video, dark_reference, strength=strength) for strength in strengths]
    paths = [tmp_path / f"{k}.mp4" for k in range(len(looks))]
    seen: list[tuple[int, int]] = []
    pvg.render(video, looks, paths, crf=0, progress=lambda _, done, total: seen.append((done, total)))
    assert seen == [(k, 2 * video.frame_count) for k in range(1, 2 * video.frame_count + 1)]
    for look, path in zip(looks, paths, strict=True):
        written = [frame.planes for frame in read_frames(path)]
        assert len(written) == video.frame_count
        (drawn,) = Renderer(video, [look]).draw(source_frame(video, 30))
        for one, other in zip(drawn.planes, written[30], strict=True):
            np.testing.assert_array_equal(one, other)
