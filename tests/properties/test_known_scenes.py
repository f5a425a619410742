"""Accuracy on small scenes whose truth is known: a real face on a known path, in known light, behind a known occluder.

Every scene goes the whole way: clip, landmarks, matte, curves, transport, rendering. The pinned errors are today's;
each may grow by 5 % before its test fails. Pin lower when they fall.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

import pvg
from benchmarks.quality.leak import leak_frames
from benchmarks.quality.lossless import write_lossless
from benchmarks.quality.measures import iou, psnr, wander
from pvg.rendering import Renderer
from pvg.video import read_frames
from scripts.samples import Samples
from tests.gallery.scenes import (
    SIDE,
    Affine,
    Subject,
    at_rest,
    behind_bar,
    grown,
    in_shade,
    on_path,
    passing_bar,
    path,
    resting_face,
    shrunk,
)

# Behind "before" stands what there was until a network refined the masks and the reference was sampled evenly, which
# makes this look a stronger change, and with it all that is a share of it.
PINNED = {
    "mask": 0.0587,  # share of the union of found and true skin that only one holds; before 0.0748
    # dB; before 0.0035, then 0.0040 until the last row of a neck that the picture cuts took the look; wanted are 0.02
    "steadiness": 0.0047,
    "warping": 1.82,  # output / input, by the known path; before 1.85
    "flutter": 0.554,  # levels: how much a skin point's correction changes while the face moves; before 0.549
    "leak": 0.0320,  # levels; before 0.0181; wanted are 0.2
    # levels: how much a change of light changes the correction; before 0.661, then 0.667 until a flush that gets less
    # red got lighter: the curves add that, and light that changes does not change it
    "light": 0.740,
    # levels on the occluder, over the face; before 0.121, until skin was told in usual light, then 0.129 likewise
    "occluder": 0.141,
    "beside the occluder": 2.05,  # levels between two frames, away from it; before 1.95
    "after the occluder": 0.405,  # levels, against before; before 0.414
}
WORSE = 1.05  # how much a pinned error may grow


@pytest.fixture(scope="module")
def subject(samples: Samples) -> Subject:
    return resting_face(samples)


@dataclass(frozen=True)
class Run:
    """A scene's frames as they were and in the reference's colours, and the masks found: lists of (SIDE, SIDE, ...)."""

    source: list[np.ndarray]
    result: list[np.ndarray]
    mask: list[np.ndarray]

    @property
    def corrections(self) -> list[np.ndarray]:
        """What was added, frame by frame, in levels."""
        return [after.astype(np.float32) - before for before, after in zip(self.source, self.result, strict=True)]


def _run(frames: Iterable[np.ndarray], reference: pvg.VectorVideo, folder: Path) -> Run:
    """Vectorise the scene and render it with lambda = 1, which adds a membrane and nothing else."""
    clip = folder / "scene.mp4"
    write_lossless(clip, iter(frames))
    xs = np.arange(SIDE, dtype=np.float32)
    source, result, masks = [], [], []
    with pvg.vectorize(clip, asset=folder / "scene.pvg") as video:
        renderer = Renderer(video, [pvg.transfer(video, reference, contrast=1.0, light=0.0, scene=0.0, extent="face")])
        for frame in read_frames(clip):
            data = video.face_at(0, frame.index)
            assert data is not None
            source.append(frame.rgb())
            result.append(renderer.draw(frame)[0].rgb())
            masks.append(data.matte.mask_at(xs, xs))
    return Run(source, result, masks)


@pytest.fixture(scope="module")
def moving(
    subject: Subject, dark_reference: pvg.VectorVideo, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[Affine], Run]:
    """A face that moves through a shade."""
    paths = [path(k) for k in range(14)]
    frames = (in_shade(on_path(subject.rgb, affine), k) for k, affine in enumerate(paths))
    return paths, _run(frames, dark_reference, tmp_path_factory.mktemp("moving"))


def _holds(name: str, error: float) -> None:
    assert error <= WORSE * PINNED[name], f"{name}: {error:.4f}, pinned {PINNED[name]}"


def test_the_mask_follows_a_face_on_a_known_path(subject: Subject, moving: tuple[list[Affine], Run]) -> None:
    paths, run = moving
    truths = [on_path(subject.skin.astype(np.float32), affine) > 0.5 for affine in paths]
    _holds("mask", float(np.mean([1 - iou(*pair) for pair in zip(run.mask, truths, strict=True)])))


def test_a_moving_faces_result_is_as_steady_as_its_source(subject: Subject, moving: tuple[list[Affine], Run]) -> None:
    paths, run = moving
    where = [on_path(subject.inner.astype(np.float32), affine) > 0.5 for affine in paths]
    ratios = [psnr(*frames, there) for *frames, there in zip(run.source, run.result, where, strict=True)]
    assert max(ratios) < 30  # the look is far from the source
    _holds("steadiness", float(np.std(ratios)))


def test_results_flicker_little_more_than_their_sources(subject: Subject, moving: tuple[list[Affine], Run]) -> None:
    paths, run = moving

    def flicker(frames: Sequence[np.ndarray]) -> float:
        rested = [at_rest(frame, affine)[subject.around] for frame, affine in zip(frames, paths, strict=True)]
        return float(np.mean(np.diff(rested, axis=0) ** 2))

    _holds("warping", flicker(run.result) / flicker(run.source))


def test_the_correction_sticks_to_a_moving_face(subject: Subject, moving: tuple[list[Affine], Run]) -> None:
    paths, run = moving
    rested = [at_rest(added, affine)[subject.inner] for added, affine in zip(run.corrections, paths, strict=True)]
    assert np.abs(np.mean(rested)) > 20
    _holds("flutter", float(np.std(rested, axis=0).mean()))


def test_what_grows_behind_a_face_does_not_change_it(
    subject: Subject, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    person = cv2.GaussianBlur(cv2.dilate(subject.skin.astype(np.float32), np.ones((17, 17))), (0, 0), 1.0)
    run = _run(leak_frames(subject.rgb, person, 20), dark_reference, tmp_path)
    behind = person == 0
    assert run.source[-1][behind].mean() > run.source[0][behind].mean() + 100
    _holds("leak", wander(np.array([added[subject.inner].mean(axis=0) for added in run.corrections])))


def test_a_flash_and_a_shadow_survive_as_light(
    subject: Subject, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    lights = (1.0, 1.0, 1.12, 0.75, 0.9, 1.0, 0.6, 1.0)
    frames = (np.clip(np.rint(subject.rgb * light), 0, 255).astype(np.uint8) for light in lights)
    run = _run(frames, dark_reference, tmp_path)
    added = np.stack([correction[subject.inner] for correction in run.corrections])
    levels = [frame[subject.inner].mean() for frame in run.result]
    assert max(levels) - min(levels) > 40  # the light is still there
    _holds("light", float(np.abs(added - added[0]).mean(axis=(1, 2)).max()))


@pytest.fixture(scope="module")
def occluded(
    subject: Subject, dark_reference: pvg.VectorVideo, tmp_path_factory: pytest.TempPathFactory
) -> tuple[np.ndarray, Run]:
    """A resting face that a bar passes: (frames, SIDE, SIDE) bool, where the bar is, and the scene."""
    there = passing_bar()
    frames = (behind_bar(subject.rgb, bar, k) for k, bar in enumerate(there))
    return there, _run(frames, dark_reference, tmp_path_factory.mktemp("occluded"))


def test_an_occluder_keeps_most_of_its_colour(subject: Subject, occluded: tuple[np.ndarray, Run]) -> None:
    there, run = occluded
    cores = [shrunk(bar, 9) for bar in there]
    shifts = [np.abs(added[core & subject.inner]) for added, core in zip(run.corrections, cores, strict=True)]
    touched = [shift.mean() for shift in shifts if len(shift) > 200]
    assert len(touched) >= 6
    _holds("occluder", float(np.mean(touched)))


def test_colours_beside_an_occluder_do_not_jump(subject: Subject, occluded: tuple[np.ndarray, Run]) -> None:
    there, run = occluded
    near = [grown(bar, 31) for bar in there]
    steps = []
    for k in range(1, len(near)):
        away = subject.inner & ~near[k] & ~near[k - 1]
        steps.append(np.abs(run.corrections[k] - run.corrections[k - 1])[away].mean())
    _holds("beside the occluder", float(max(steps)))


def test_colours_return_when_the_occluder_is_gone(subject: Subject, occluded: tuple[np.ndarray, Run]) -> None:
    _, run = occluded
    before, after = (np.mean(part, axis=0)[subject.inner] for part in (run.corrections[:2], run.corrections[-2:]))
    assert np.abs(before).mean() > 20
    _holds("after the occluder", float(np.abs(after - before).mean()))
