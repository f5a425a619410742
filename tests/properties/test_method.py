"""What the method promises, on a real clip: METHOD's identity, texture, light, locality, contrast."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

import pvg
from pvg.face import layout
from pvg.looks import LIGHT, sliced_wasserstein
from pvg.rendering import Renderer, placed_faces, source_frame
from pvg.rendering.edges import follow_edges
from pvg.vectorization.open_skin import skin_sample
from pvg.video import Frame

FRAMES = (0, 17, 39)


def frames_of(video: pvg.VectorVideo) -> Iterator[Frame]:
    for index in FRAMES:
        yield source_frame(video, index)


def matte_of(video: pvg.VectorVideo, frame: Frame) -> np.ndarray:
    """(H, W) float32 matte of all faces."""
    matte = np.zeros((frame.height, frame.width), np.float32)
    for _, cells in placed_faces(video, frame.index):
        placed = follow_edges(cells, frame)
        x0, y0, x1, y1 = placed.window
        part = matte[y0:y1, x0:x1]
        np.maximum(part, placed.alpha, out=part)
    return matte


@pytest.fixture(scope="module")
def dark_look(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> pvg.Look:
    """The paper's settings: all colours together, lambda 1."""
    return pvg.transfer(video, dark_reference, match="color", contrast=1.0, extent="face")


@pytest.mark.parametrize("match", ["color", "semantic"])
@pytest.mark.parametrize("contrast", [1.0, "auto"])
def test_own_colours_return_the_clip(video: pvg.VectorVideo, match: str, contrast: float) -> None:
    look = pvg.transfer(video, video, match=match, contrast=contrast)
    for frame in frames_of(video):
        (drawn,) = Renderer(video, [look]).draw(frame)
        for ours, theirs in zip(drawn.planes, frame.planes, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        assert np.abs(drawn.rgb().astype(int) - frame.rgb()).max() <= 1


def test_pixels_outside_the_matte_keep_their_bits(video: pvg.VectorVideo, dark_look: pvg.Look) -> None:
    for frame in frames_of(video):
        (drawn,) = Renderer(video, [dark_look]).draw(frame)
        matte = matte_of(video, frame)
        assert 0.02 < (matte > 0).mean() < 0.6
        outside = matte == 0
        np.testing.assert_array_equal(drawn.planes[0][outside], frame.planes[0][outside])
        blocks = matte[: frame.height // 2 * 2, : frame.width // 2 * 2]
        blocks = blocks.reshape(frame.height // 2, 2, frame.width // 2, 2).max(axis=(1, 3))
        for ours, theirs in zip(drawn.planes[1:], frame.planes[1:], strict=True):
            np.testing.assert_array_equal(ours[blocks == 0], theirs[blocks == 0])
        assert (drawn.planes[0] != frame.planes[0])[matte > 0.9].mean() > 0.9


def test_strength_zero_is_the_clip(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    for contrast in (1.0, 1.4, "auto"):
        look = pvg.transfer(video, dark_reference, strength=0.0, contrast=contrast)
        for frame in frames_of(video):
            (drawn,) = Renderer(video, [look]).draw(frame)
            for ours, theirs in zip(drawn.planes, frame.planes, strict=True):
                np.testing.assert_array_equal(ours, theirs)


def test_texture_is_untouched_at_lambda_one(video: pvg.VectorVideo, dark_look: pvg.Look) -> None:
    """The change is a membrane: the Laplacian inside the full matte correlates with the source's at 0.99 or more."""
    for frame in frames_of(video):
        (drawn,) = Renderer(video, [dark_look]).draw(frame)
        inner = cv2.erode((matte_of(video, frame) > 0.999).astype(np.uint8), np.ones((9, 9))).astype(bool)
        before, after = (cv2.Laplacian(f.planes[0].astype(np.float32), cv2.CV_32F)[inner] for f in (frame, drawn))
        assert np.corrcoef(before, after)[0, 1] >= 0.99


@pytest.mark.parametrize("contrast", [0.7, 1.5])
def test_lambda_changes_contrast_not_mean_colour(video: pvg.VectorVideo, contrast: float) -> None:
    look = pvg.transfer(video, video, contrast=contrast, protect=())
    for frame in frames_of(video):
        # a softer copy of the frame, so that nothing clips at white or black
        soft = replace(frame, planes=(np.rint(0.5 * frame.planes[0] + 60).astype(np.uint8), *frame.planes[1:]))
        (drawn,) = Renderer(video, [look]).draw(soft)
        matte = matte_of(video, frame)
        change = drawn.rgb().astype(float) - soft.rgb()
        mean = np.average(change.reshape(-1, 3), axis=0, weights=matte.ravel())
        assert np.abs(mean).max() < 0.75
        inner = matte > 0.999
        low = pvg.layer(video, frame.index, "low")[inner].astype(float)
        before, after = (picture.rgb()[inner] - low for picture in (soft, drawn))
        slope = np.polyfit(before.ravel(), after.ravel(), 1)[0]
        assert slope == pytest.approx(contrast, abs=0.03)


def test_light_that_changes_in_the_clip_survives_exactly(video: pvg.VectorVideo, dark_look: pvg.Look) -> None:
    """A flash in the source (the paper's Fig. 8) reaches the result as it is: nothing is fitted to the frame."""
    frame = source_frame(video, FRAMES[1])
    luma = np.clip(frame.planes[0].astype(int) + 12, 0, 235).astype(np.uint8)
    flashed = replace(frame, planes=(luma, *frame.planes[1:]))
    renderer = Renderer(video, [dark_look])
    (plain,), (flash,) = renderer.draw(frame), renderer.draw(flashed)
    unclipped = (frame.planes[0] < 220) & (plain.planes[0] > 1)
    change = flash.planes[0].astype(int) - plain.planes[0]
    assert np.abs(change - 12)[unclipped].max() <= 1


def test_colours_reach_the_reference(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo
) -> None:
    for reference in (dark_reference, pale_reference):
        look = pvg.transfer(video, reference, match="color")
        key, target = video.records[0].key_frames[0], reference.records[0].key_frames[0]
        rng = np.random.default_rng(0)
        before = sliced_wasserstein(key.colors[key.visible], target.colors[target.visible], rng=rng)
        after = sliced_wasserstein(look.colors[0][0][key.visible], target.colors[target.visible], rng=rng)
        assert after < 0.1 * before


@pytest.mark.parametrize(("light", "left"), [(LIGHT, 0.2), (0.25, 0.25)])
def test_open_skin_gets_the_colour_of_the_references_open_skin(
    light: float, left: float, video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo
) -> None:
    """In pixels, where nothing gives way to the scene: the median comes within a few levels of the reference's."""
    key = video.records[0].key_frames[0]
    data = video.face_at(0, key.frame)
    assert data is not None
    matte = matte_of(video, source_frame(video, key.frame))
    for reference in (dark_reference, pale_reference):
        drawn = pvg.render_frame(video, pvg.transfer(video, reference, light=light, scene=0.0), key.frame)
        skin, _ = skin_sample(drawn, matte, data.landmarks)
        wanted = np.median(reference.records[0].key_frames[0].skin, axis=0)
        before = np.abs(np.median(key.skin, axis=0) - wanted).max()
        assert before > 20
        assert np.abs(np.median(skin, axis=0) - wanted).max() < left * before


def test_by_default_open_skin_goes_part_of_the_way(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo
) -> None:
    """In pixels: brightness and hue that lie far from the clip's give way to its scene, more than half of darkness."""
    key = video.records[0].key_frames[0]
    data = video.face_at(0, key.frame)
    assert data is not None
    matte = matte_of(video, source_frame(video, key.frame))
    start = np.median(key.skin, axis=0)
    for reference in (dark_reference, pale_reference):  # brown skin in more light than the clip's, pale skin in less
        drawn = pvg.render_frame(video, pvg.transfer(video, reference, light=0.0), key.frame)
        skin, _ = skin_sample(drawn, matte, data.landmarks)
        way = np.median(reference.records[0].key_frames[0].skin, axis=0) - start
        assert 0.4 < (np.median(skin, axis=0) - start) @ way / (way @ way) < 0.95


def test_looks_drawn_together_are_those_drawn_alone(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo
) -> None:
    looks = [
        pvg.transfer(video, dark_reference),
        pvg.transfer(video, pale_reference, contrast="auto"),
        pvg.transfer(video, pale_reference, contrast=1.3, strength=0.5, match="semantic"),
    ]
    frame = source_frame(video, FRAMES[1])
    together = Renderer(video, looks).draw(frame)
    for look, drawn in zip(looks, together, strict=True):
        (alone,) = Renderer(video, [look]).draw(frame)
        for ours, theirs in zip(drawn.planes, alone.planes, strict=True):
            assert np.abs(ours.astype(int) - theirs).max() <= 1


def test_a_frame_drawn_alone_is_the_frame_of_the_clip(video: pvg.VectorVideo, dark_look: pvg.Look) -> None:
    renderer = Renderer(video, [dark_look])
    for index in (5, 3, 30, 4):  # any order
        (drawn,) = renderer.draw(source_frame(video, index))
        np.testing.assert_array_equal(drawn.rgb(), pvg.render_frame(video, dark_look, index))


def test_eyes_and_teeth_keep_their_colour_unless_asked(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    frame = source_frame(video, FRAMES[1])
    kept, moved = Renderer(
        video,
        [
            pvg.transfer(video, dark_reference, match="color", contrast=1.0, protect=protect)
            for protect in (("eyes", "teeth"), ())
        ],
    ).draw(frame)
    data = video.face_at(0, frame.index)
    assert data is not None
    for pupil in data.landmarks.points[layout.PUPILS]:
        x, y = np.rint(pupil).astype(int)
        source = int(frame.planes[0][y, x])
        assert abs(int(kept.planes[0][y, x]) - source) <= 3
        assert abs(int(moved.planes[0][y, x]) - source) > abs(int(kept.planes[0][y, x]) - source)
