"""What the frames around one agree on of a body, which moves through the cells of its scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from pvg._arrays import Bytes
from pvg.raster import Raster
from pvg.skin import BodyConsensus, BodyInTime, Scene

SHAPE = (60, 80)
BLOCKS = (30, 40)
FRAMES = 12
STEP = 4  # cells a frame, of what moves
INNER = np.s_[21:39, 11:25]  # of an arm: its edge may be a little off


def scene(moves: float | None = 0.0, rgb: Bytes | None = None, *, changed: bool = False) -> Scene:
    """moves: cells to the right since the scene before, None with a cut."""
    flow = None if moves is None else np.zeros((*BLOCKS, 2), np.float32)
    if flow is not None and moves is not None:
        flow[..., 0] = -moves * BLOCKS[1] / SHAPE[1]
    picture = np.full((*SHAPE, 3), 120, np.uint8) if rgb is None else rgb
    person = np.full(SHAPE, 255, np.uint8)
    return Scene(Raster(np.zeros(2, np.float32), 1.0, SHAPE), picture, person, flow, (), changed, 0, 0.2)


def arm(moved: int = 0) -> Bytes:
    alpha = np.zeros(SHAPE, np.uint8)
    alpha[20:40, 10 + moved : 26 + moved] = 255
    return alpha


def agreed(scenes: Sequence[Scene], alphas: Sequence[Bytes]) -> list[Bytes]:
    consensus = BodyConsensus()
    out = [consensus.add(BodyInTime(alpha, one)) for one, alpha in zip(scenes, alphas, strict=True)]
    return [alpha for alpha in out if alpha is not None] + consensus.end()


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_every_frame_gets_a_matte_in_its_order(count: int) -> None:
    alphas = [np.full(SHAPE, 35 * k, np.uint8) for k in range(count)]
    out = agreed([scene(None)] * count, alphas)
    assert [int(alpha[0, 0]) for alpha in out] == [35 * k for k in range(count)]


@pytest.mark.parametrize("moves", [0, STEP])
def test_an_arm_that_is_lost_for_a_frame_stays(moves: int) -> None:
    whole = [arm(moves * k) for k in range(FRAMES)]
    alphas = [*whole[:5], np.zeros(SHAPE, np.uint8), *whole[6:]]
    out = agreed([scene(moves) for _ in alphas], alphas)
    for k in (4, 6):
        np.testing.assert_array_equal(out[k], whole[k])
    inner = np.s_[22:38, 12 + 5 * moves : 24 + 5 * moves]  # an edge may be a little off
    assert out[5][inner].min() == 255
    assert out[5][whole[5] == 0].max() == 0


@pytest.mark.parametrize("moves", [0, STEP])
def test_what_is_taken_in_for_a_frame_is_not(moves: int) -> None:
    alphas = [np.zeros(SHAPE, np.uint8) for _ in range(FRAMES)]
    alphas[5] = arm()
    assert max(int(alpha.max()) for alpha in agreed([scene(moves) for _ in alphas], alphas)) == 0


@pytest.mark.parametrize("frames", [(5,), (5, 9), (2, 6, 10)])
def test_what_single_frames_take_in_is_never_seen_in_others(frames: tuple[int, ...]) -> None:
    alphas = [arm() if k in frames else np.zeros(SHAPE, np.uint8) for k in range(FRAMES)]
    assert not any(alpha.any() for alpha in agreed([scene() for _ in alphas], alphas)[2:-2])


@pytest.mark.parametrize("frames", [(5,), (5, 9), (2, 6, 10)])
def test_what_single_frames_lose_is_never_missed(frames: tuple[int, ...]) -> None:
    alphas = [np.zeros(SHAPE, np.uint8) if k in frames else arm() for k in range(FRAMES)]
    for alpha in agreed([scene() for _ in alphas], alphas)[3:-2]:
        assert alpha[INNER].min() == 255


def test_what_every_second_frame_has_does_not_blink() -> None:
    alphas = [arm() * (k % 2) for k in range(FRAMES)]
    inner = [alpha[INNER] for alpha in agreed([scene() for _ in alphas], alphas)[3:-3]]
    assert len(np.unique(inner)) == 1


def test_a_part_that_is_lost_elsewhere_than_a_hand_passes_stays() -> None:
    picture = np.full((*SHAPE, 3), 120, np.uint8)
    picture[:12, 50:] = 240  # much of the picture is not where the flow has it
    alphas = [np.zeros(SHAPE, np.uint8) if k == 5 else arm() for k in range(FRAMES)]
    scenes = [scene(rgb=picture if k == 5 else None, changed=k == 5) for k in range(FRAMES)]
    assert agreed(scenes, alphas)[5][INNER].min() == 255


@pytest.mark.parametrize("drift", [-0.02, 0.0, 0.02])
def test_an_arm_that_the_picture_cuts_is_held_to_its_edge(drift: float) -> None:
    cut = np.zeros(SHAPE, np.uint8)
    cut[40:, 20:40] = 255
    alphas = [np.zeros(SHAPE, np.uint8) if k == 5 else cut for k in range(FRAMES)]
    out = agreed([scene(drift) for _ in alphas], alphas)[5]
    assert out[42:, 22:38].min() == 255


def test_a_narrow_arm_that_moves_faster_than_it_is_wide_stays() -> None:
    whole = [np.zeros(SHAPE, np.uint8) for _ in range(FRAMES)]
    for k, alpha in enumerate(whole):
        alpha[20:40, 4 + 6 * k : 9 + 6 * k] = 255
    alphas = [*whole[:5], np.zeros(SHAPE, np.uint8), *whole[6:]]
    out = agreed([scene(6) for _ in alphas], alphas)[5]
    assert out[22:38, 36:37].min() == 255


def test_what_moves_down_is_followed_too() -> None:
    whole = [np.roll(arm(), 2 * k, axis=0) for k in range(8)]
    scenes = [scene() for _ in whole]
    for one in scenes:
        assert one.flow is not None
        one.flow[..., 1] = -2 * BLOCKS[0] / SHAPE[0]
    alphas = [*whole[:4], np.zeros(SHAPE, np.uint8), *whole[5:]]
    assert agreed(scenes, alphas)[4][30:46, 12:24].min() == 255


def test_what_comes_to_stay_comes_in_steps() -> None:
    alphas = [np.zeros(SHAPE, np.uint8)] * 5 + [arm()] * 7
    levels = [int(alpha[30, 18]) for alpha in agreed([scene() for _ in alphas], alphas)]
    assert levels == [0] * 4 + [85, 170] + [255] * 6


def test_what_moves_as_its_picture_does_stays_as_it_is() -> None:
    alphas = [arm(STEP * k) for k in range(FRAMES)]
    for out, alpha in zip(agreed([scene(STEP) for _ in alphas], alphas), alphas, strict=True):
        np.testing.assert_array_equal(out, alpha)


@pytest.mark.parametrize("told", [True, False], ids=["a cut", "a cut that was not told"])
def test_nothing_is_taken_over_from_another_shot(told: bool) -> None:
    alphas = [arm()] * 4 + [arm(40)] * 4
    other = np.full((*SHAPE, 3), 210, np.uint8)
    first = scene(None if told else 0, other, changed=not told)
    scenes = [scene()] * 4 + [first] + [scene(rgb=other)] * 3
    for out, alpha in zip(agreed(scenes, alphas), alphas, strict=True):
        np.testing.assert_array_equal(out, alpha)


def test_a_hand_that_the_picture_shows_to_pass_keeps_its_matte() -> None:
    alphas = [np.zeros(SHAPE, np.uint8) for _ in range(FRAMES)]
    alphas[5] = arm()
    pictures = [np.where(alpha[..., None] > 0, 220, 120).astype(np.uint8).repeat(3, axis=2) for alpha in alphas]
    out = agreed([scene(rgb=picture) for picture in pictures], alphas)
    np.testing.assert_array_equal(out[5], arm())


def test_what_comes_in_from_beyond_the_picture_is_not_held_to_what_was_not_seen() -> None:
    alphas = []
    for k in range(FRAMES):
        alpha = np.zeros(SHAPE, np.uint8)
        alpha[20:40, : STEP * k] = 255
        alphas.append(alpha)
    for out, alpha in zip(agreed([scene(STEP) for _ in alphas], alphas), alphas, strict=True):
        np.testing.assert_array_equal(out, alpha)
