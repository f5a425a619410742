from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pvg
from pvg.rendering import Renderer, source_frame
from pvg.video import probe, read_frames
from scripts.samples import Samples
from tests.gallery.clips import cut_clip


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


def test_an_image_is_rendered_as_an_image(samples: Samples, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    with pvg.vectorize(samples.portrait) as image:
        assert image.media.kind == "image"
        look = pvg.transfer(image, dark_reference)
        pvg.render(image, [look], [tmp_path / "out.png"])
        (frame,) = read_frames(tmp_path / "out.png")
        np.testing.assert_array_equal(frame.rgb(), pvg.render_frame(image, look, 0))
        own = pvg.render_frame(image, pvg.transfer(image, image), 0)
        np.testing.assert_array_equal(own, pvg.render_frame(image, None, 0))


def test_a_swap_has_a_contrast_for_each_side(video: pvg.VectorVideo, samples: Samples, tmp_path: Path) -> None:
    with pvg.vectorize(samples.dark_portrait) as image:
        pvg.swap(video, image, [tmp_path / "a.mp4", tmp_path / "b.png"], contrast=(0.8, 1.2), preset="ultrafast")
        (drawn,) = read_frames(tmp_path / "b.png")
        expected = pvg.render_frame(image, pvg.transfer(image, video, contrast=1.2), 0)
        np.testing.assert_array_equal(drawn.rgb(), expected)


def test_a_swap_within_one_clip_exchanges_two_faces_and_leaves_the_others(
    group: pvg.VectorVideo, tmp_path: Path
) -> None:
    pvg.swap(group, paths=tmp_path / "swapped.png", faces=(1, 4), contrast=(0.8, "auto"))
    (swapped,) = read_frames(tmp_path / "swapped.png")
    look = pvg.exchange(group, (1, 4), contrast=(0.8, "auto"))
    np.testing.assert_array_equal(swapped.rgb(), pvg.render_frame(group, look, 0))
    changed = (swapped.rgb() != pvg.render_frame(group, None, 0)).any(axis=2)
    for face in group.faces:
        found = group.face_at(face.index, 0)
        assert found is not None
        x, y = found.landmarks.points.mean(axis=0).astype(int)
        share = changed[y - 20 : y + 20, x - 20 : x + 20].mean()
        assert share > 0.9 if face.index in (1, 4) else share == 0


def test_one_look_of_two_faces_draws_what_two_looks_do(group: pvg.VectorVideo) -> None:
    """Also where one λ is a number and the other a field."""
    one = pvg.transfer(group, group, faces=[1], reference_face=4, contrast=0.8)
    two = pvg.transfer(group, group, faces=[4], reference_face=1)
    plain, first, second, both = (
        pvg.render_frame(group, look, 0).astype(int) for look in (None, one, two, one.merged(two))
    )
    np.testing.assert_array_equal(both, first + second - plain)
    assert np.abs(both - plain).max() > 20


def test_a_clip_is_not_swapped_with_itself(video: pvg.VectorVideo, group: pvg.VectorVideo, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    with pytest.raises(ValueError, match="swapped with itself"):
        pvg.swap(video, video, [out, out])
    with pytest.raises(ValueError, match="of two faces"):
        pvg.swap(group, paths=out)
    with pytest.raises(ValueError, match="two different faces"):
        pvg.swap(group, paths=out, faces=(1, 1))
    with pytest.raises(ValueError, match="no face 7"):
        pvg.swap(group, paths=out, faces=(0, 7))
    with pytest.raises(ValueError, match="one path"):
        pvg.swap(group, paths=[out, out], faces=(0, 1))
    with pytest.raises(ValueError, match="one for each"):
        pvg.swap(group, paths=out, faces=(0, 1), contrast=(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="contrast must be"):
        pvg.swap(group, paths=out, faces=(0, 1), contrast=(1.0, 2.0))
    assert list(tmp_path.iterdir()) == []


def test_swap_gives_each_the_others_colours(video: pvg.VectorVideo, samples: Samples, tmp_path: Path) -> None:
    with pvg.vectorize(samples.dark_portrait) as image:
        pvg.swap(video, image, [tmp_path / "a.mp4", tmp_path / "b.png"], crf=10)
        key, other = video.records[0].key_frames[0], image.records[0].key_frames[0]
        expected = pvg.render_frame(image, pvg.transfer(image, video), 0)
        (swapped,) = read_frames(tmp_path / "b.png")
        np.testing.assert_array_equal(swapped.rgb(), expected)
        gap = np.linalg.norm(key.colors.mean(axis=0) - other.colors.mean(axis=0))
        assert gap > 20
        assert probe(tmp_path / "a.mp4").frame_count == video.frame_count


def test_a_reference_asset_cannot_be_rendered(samples: Samples, tmp_path: Path) -> None:
    clip = cut_clip(samples.woman_clip, tmp_path / "clip.mp4", 0, 12)
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
