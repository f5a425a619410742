from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pvg
from pvg.asset import FaceInFrame, VectorVideo
from pvg.face import layout
from pvg.looks.look import Contrast
from pvg.rendering import Renderer, source_frame
from pvg.skin import Matte
from pvg.video import read_frames
from scripts.samples import Samples


def test_a_look_asked_for_twice_is_drawn_twice_alike(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    look = pvg.transfer(video, dark_reference)
    one, two = Renderer(video, [look, look]).draw(source_frame(video, 3))
    (alone,) = Renderer(video, [look]).draw(source_frame(video, 3))
    np.testing.assert_array_equal(one.planes[0], two.planes[0])
    np.testing.assert_array_equal(one.planes[0], alone.planes[0])


def test_a_look_is_drawn_alike_whatever_other_looks_are_drawn_beside_it(
    group: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    """Of people who stand close together, whose bodies' mattes overlap, each look changes one."""
    frame = source_frame(group, 0)
    looks = [pvg.transfer(group, dark_reference, faces=[face]) for face in range(3)]
    for look, beside in zip(looks, Renderer(group, looks).draw(frame), strict=True):
        (alone,) = Renderer(group, [look]).draw(frame)
        np.testing.assert_array_equal(np.stack(alone.planes), np.stack(beside.planes))


def test_a_frame_drawn_alone_is_the_frame_of_the_clip(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    look = pvg.transfer(video, dark_reference)
    through = Renderer(video, [look])
    for frame in read_frames(video.require_source(), stop=12):
        (drawn,) = through.draw(frame)
        if frame.index in (0, 11):
            np.testing.assert_array_equal(drawn.rgb(), pvg.render_frame(video, look, frame.index))


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


def test_a_look_for_one_face_leaves_the_other_faces_alone(samples: Samples, dark_reference: pvg.VectorVideo) -> None:
    with pvg.vectorize(samples.several_faces) as image:
        assert len(image.faces) >= 2
        before = pvg.render_frame(image, None, 0).astype(int)
        after = pvg.render_frame(image, pvg.transfer(image, dark_reference, faces=[0]), 0).astype(int)
        change = np.abs(after - before).max(axis=2)
        for face in image.faces:
            data = image.face_at(face.index, 0)
            assert data is not None
            x, y = np.rint(data.landmarks.points[layout.NOSE_TIP]).astype(int)
            there = change[y - 3 : y + 4, x - 3 : x + 4]
            assert there.max() > 5 if face.index == 0 else there.max() == 0


@pytest.mark.parametrize("contrast", ["auto", 1.3])
def test_a_speck_of_matte_that_no_curve_crosses_stays_as_it_is(
    video: pvg.VectorVideo,
    dark_reference: pvg.VectorVideo,
    face: FaceInFrame,
    monkeypatch: pytest.MonkeyPatch,
    contrast: Contrast,
) -> None:
    """As the paper's rule may leave specks: one between curves ended the rendering of its clip."""
    alpha = np.zeros_like(face.matte.alpha)
    frame = next(read_frames(video.require_source(), start=20))
    renderer = Renderer(video, [pvg.transfer(video, dark_reference, contrast=contrast, extent="face")])
    box, changed = face.matte.raster.box, []
    monkeypatch.setattr(VectorVideo, "face_at", lambda *_: replace(face, matte=Matte.over(box, alpha)))
    for row in range(4, len(alpha), 32):
        for column in range(4, alpha.shape[1], 32):
            alpha[:] = 0
            alpha[row, column] = 255
            (drawn,) = renderer.draw(frame)
            changed.append(any((a != b).any() for a, b in zip(drawn.planes, frame.planes, strict=True)))
    assert True in changed
    assert False in changed
