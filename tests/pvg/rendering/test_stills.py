from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pvg
from pvg.looks import color_map
from pvg.rendering import LAYERS, Stills, around, source_frame
from pvg.rendering.pictures import thumbnail
from pvg.video import key_pictures, read_frames
from tests.gallery.clips import encode_raw, libav_frame


@pytest.fixture(scope="module")
def stills(video: pvg.VectorVideo) -> Stills:
    return Stills(video)


def test_a_still_is_the_frame_of_the_rendered_clip(
    stills: Stills, video: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    look = pvg.transfer(video, dark_reference)
    np.testing.assert_array_equal(stills.drawn(look, 20), pvg.render_frame(video, look, 20))
    np.testing.assert_array_equal(stills.drawn(None, 20), pvg.render_frame(video, None, 20))
    for name in LAYERS:
        np.testing.assert_array_equal(stills.layer(20, name), pvg.layer(video, 20, name))


def test_a_frame_is_decoded_once(stills: Stills) -> None:
    assert stills.frame(7) is stills.frame(7)


def test_single_frames_of_an_asset_go_on_from_one_another_until_it_is_closed(
    video: pvg.VectorVideo, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pvg.open_asset(video.path, video.source) as asset:
        expected = [pvg.render_frame(video, None, index) for index in (11, 13, 24)]
        first = source_frame(asset, 11)

        def refuse(*_: object) -> None:
            raise AssertionError("the clip is opened again")

        monkeypatch.setattr("pvg.video.single_frames.open_clip", refuse)
        monkeypatch.setattr("pvg.video.reading.open_clip", refuse)
        seen = [first, source_frame(asset, 13), Stills(asset).frame(24)]
        for frame, rgb in zip(seen, expected, strict=True):
            np.testing.assert_array_equal(frame.rgb(), rgb)
    with pytest.raises(AssertionError, match="opened again"):
        source_frame(asset, 25)


def test_frames_that_are_not_there_are_refused(stills: Stills) -> None:
    for index in (-1, 40):
        with pytest.raises(ValueError, match="the clip has 40"):
            stills.frame(index)
        with pytest.raises(ValueError, match="the clip has 40"):
            stills.nearest(index)


def test_the_nearest_frame_is_a_key_picture_or_one_that_is_there(video: pvg.VectorVideo) -> None:
    fresh = Stills(video)
    keys = key_pictures(video.require_source())
    assert keys is not None
    assert keys[0] == 0
    assert fresh.nearest(17) in keys
    assert abs(fresh.nearest(17) - 17) == min(abs(key - 17) for key in keys)
    fresh.frame(17)
    assert fresh.nearest(17) == 17


def test_of_a_reference_only_frames_that_it_keeps_are_near(
    short_clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its file has key pictures beyond them."""
    pictures = [libav_frame(frame.rgb()) for frame in read_frames(short_clip, stop=6)]
    clip = encode_raw(tmp_path / "keys.mp4", pictures, "libx264", g="4", sc_threshold="0")
    monkeypatch.setattr("pvg.vectorization.references._REFERENCE_FRAMES", 4)
    with pvg.vectorize(clip, reference=True) as reference:
        stills = Stills(reference)
        assert reference.frame_count == 4
        assert key_pictures(clip) == (0, 4)
        assert stills.nearest(3) == 0
        assert stills.frame(0).index == 0


def test_a_face_is_shown_where_it_is_seen(stills: Stills, video: pvg.VectorVideo) -> None:
    (seen,) = stills.seen_faces([0], 160)
    x, y, width, height = seen.box
    assert seen.frame == stills.usual_frame()
    assert seen.box == stills.face_box(0, seen.frame)
    points = video.landmarks(0)[seen.frame]
    inside = (points >= (x - 2, y - 2)).all(axis=1) & (points <= (x + width + 2, y + height + 2)).all(axis=1)
    assert inside.mean() > 0.95
    assert seen.picture.shape == (160, 160, 3)
    expected = thumbnail(stills.drawn(None, seen.frame), around(seen.box), 160)
    np.testing.assert_array_equal(seen.picture, expected)


def test_all_faces_of_a_picture_are_shown(group: pvg.VectorVideo) -> None:
    stills = Stills(group)
    seen = stills.seen_faces([face.index for face in group.faces], 64)
    assert [one.index for one in seen] == [face.index for face in group.faces]
    assert len({one.box for one in seen}) == len(group.faces) == 5


def test_an_unknown_face_is_refused(stills: Stills) -> None:
    with pytest.raises(ValueError, match="no face 3"):
        stills.face_box(3, 0)
    with pytest.raises(ValueError, match="no face 3"):
        stills.usual_frame([3])


def test_sliders_that_keep_the_colours_share_one_transport(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    color_map._moved.cache_clear()
    first = pvg.transfer(video, dark_reference)
    made = color_map._moved.cache_info().misses
    pvg.transfer(video, dark_reference, strength=0.5, contrast=1.2, makeup=0.1)
    assert color_map._moved.cache_info().misses == made > 0
    pvg.transfer(video, dark_reference, seed=1)
    assert color_map._moved.cache_info().misses > made
    color_map._moved.cache_clear()
    again = pvg.transfer(video, dark_reference)
    for face, colors in first.colors.items():
        np.testing.assert_array_equal(colors, again.colors[face])
