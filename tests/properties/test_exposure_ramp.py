"""A shot whose exposure runs from 0.4 to 1.0 of a still, or back: nothing burns out, nothing steps.

The colour that is wanted of a frame is the reference's skin, as much dimmer or brighter as the frame's exposure is
against that of the key frame that leads (`pvg.looks.exposure`): up to 1 in proportion, above it bent below white.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import pvg
from benchmarks.quality.lossless import write_lossless
from pvg.looks.exposure import Exposure, Moved, at_exposure, leading_key
from pvg.looks.opponent import to_opponent
from pvg.looks.skin_map import SkinMap
from pvg.looks.transport import sliced_transport
from pvg.rendering import Renderer
from pvg.video import read_frames
from scripts.samples import Samples
from tests.gallery.scenes import resting_face


def _lab(colors: np.ndarray) -> np.ndarray:
    """CIELAB of colours (n, 3), 0-255 RGB."""
    return cv2.cvtColor((colors[None] / 255).astype(np.float32), cv2.COLOR_RGB2Lab)[0]


def _skin_by(skin_map: SkinMap) -> Moved:
    return lambda key: (key.skin, skin_map(key.skin))


@pytest.mark.parametrize("frames", [50, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("ends", [(0.4, 1.0), (1.0, 0.4)], ids=["up", "down"])
def test_a_ramp_of_exposure_neither_burns_out_nor_steps(
    samples: Samples,
    dark_reference: pvg.VectorVideo,
    pale_reference: pvg.VectorVideo,
    tmp_path: Path,
    ends: tuple[float, float],
    frames: int,
) -> None:
    subject, gains = resting_face(samples), np.linspace(*ends, frames)
    write_lossless(tmp_path / "ramp.mp4", (np.rint(subject.rgb * gain).astype(np.uint8) for gain in gains))
    references = (dark_reference, pale_reference)
    with pvg.vectorize(tmp_path / "ramp.mp4", asset=tmp_path / "ramp.pvg") as video:
        (record,) = video.records
        assert 4 <= len(record.key_frames) <= 8
        renderer = Renderer(video, [pvg.transfer(video, reference, scene=0.0) for reference in references])
        before, after, burnt, lumas = [], [], [], []
        for frame in read_frames(video.require_source()):
            drawn = [frame.rgb()[subject.inner] for frame in renderer.draw(frame)]
            before.append(to_opponent(frame.rgb()[subject.inner])[:, 0].mean())
            lumas.append([to_opponent(one)[:, 0].mean() for one in drawn])
            after.append([np.median(one, axis=0) for one in drawn])
            burnt.append([(one.min(axis=1) >= 250).mean() for one in drawn])
    assert np.max(burnt) <= 0.02
    lead = leading_key([record])
    own_steps = np.abs(np.diff(before))
    for k, reference in enumerate(references):
        target, colors = leading_key(reference.records).skin, np.array([one[k] for one in after])
        moved = sliced_transport(lead.skin, target, beta=0.2, iterations=20, rng=np.random.default_rng(0))
        exposure = Exposure(lead, _skin_by(SkinMap.between(lead.skin, moved)))
        share = np.array([exposure.of(at_exposure(lead, gain / gains[lead.frame]))[1] for gain in gains])
        wanted = np.median(target, axis=0) * share[:, None]
        assert np.linalg.norm(_lab(colors) - _lab(wanted), axis=1).max() <= 6.5
        steps = np.abs(np.diff([one[k] for one in lumas]))
        assert (steps - own_steps).max() <= 1.5


def test_a_lamp_that_burns_skin_out_leaves_own_colours_as_they_are(samples: Samples, tmp_path: Path) -> None:
    subject, dim, lit = resting_face(samples), 34, 10
    pictures = [np.clip(np.rint(subject.rgb * gain), 0, 255).astype(np.uint8) for gain in (0.8, 1.8)]
    assert (pictures[1][subject.inner].max(axis=1) == 255).mean() > 0.2
    write_lossless(tmp_path / "lamp.mp4", [pictures[0]] * dim + [pictures[1]] * lit)
    with pvg.vectorize(tmp_path / "lamp.mp4") as video:
        assert len(video.records[0].key_frames) == 2
        # make-up is that of the reference's own light, which burns out less
        looks = [pvg.transfer(video, video, match=match, makeup=0.0) for match in ("semantic", "color")]
        renderer = Renderer(video, looks)
        (frame,) = read_frames(video.require_source(), start=dim + lit // 2, stop=dim + lit // 2 + 1)
        for drawn in renderer.draw(frame):
            np.testing.assert_allclose(drawn.rgb().astype(int), frame.rgb().astype(int), atol=1)


def test_a_coloured_lamp_lights_the_new_complexion_as_it_lit_the_own_one(
    samples: Samples, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    """The clip's own colours stay themselves in it."""
    subject, plain, red = resting_face(samples), 24, 20
    lamp = np.array((1.0, 0.55, 0.6))
    lit = np.rint(subject.rgb * lamp).astype(np.uint8)
    write_lossless(tmp_path / "lamp.mp4", [subject.rgb] * plain + [lit] * red)
    with pvg.vectorize(tmp_path / "lamp.mp4") as video:
        assert [key.frame for key in video.records[0].key_frames] == [0, plain]
        looks = [pvg.transfer(video, dark_reference), pvg.transfer(video, video, makeup=0.0)]
        renderer, drawn = Renderer(video, looks), []
        for at in (plain // 2, plain + red // 2):
            (frame,) = read_frames(video.require_source(), start=at, stop=at + 1)
            new, own = (picture.rgb() for picture in renderer.draw(frame))
            np.testing.assert_allclose(own.astype(int), frame.rgb().astype(int), atol=1)
            drawn.append(np.median(new[subject.inner], axis=0))
    before = np.median(subject.rgb[subject.inner], axis=0)
    assert np.abs(drawn[0] - before).max() > 15
    np.testing.assert_allclose(drawn[1], lamp * drawn[0], rtol=0.1)
