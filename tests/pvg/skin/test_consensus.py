"""What a matte's frames agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pvg.raster import Raster
from pvg.skin import Matte, MatteConsensus
from pvg.skin.consensus import MatteInTime

SHAPE = (60, 50)
FRAMES = 12


def in_time(alpha: np.ndarray, rgb: np.ndarray | None = None, occluder: np.ndarray | None = None) -> MatteInTime:
    raster = Raster(np.zeros(2, np.float32), 1.0, SHAPE)
    picture = np.full((*SHAPE, 3), 120, np.uint8) if rgb is None else rgb
    nothing = np.zeros(SHAPE, np.float32) if occluder is None else occluder
    return MatteInTime(raster, alpha, alpha > 127, picture, nothing, np.ones(SHAPE, np.bool_))


def skin() -> np.ndarray:
    alpha = np.zeros(SHAPE, np.uint8)
    alpha[10:50, 10:40] = 255
    return alpha


def agreed(frames: Sequence[MatteInTime]) -> list[Matte]:
    consensus = MatteConsensus()
    out = [matte for matte in map(consensus.add, frames) if matte is not None]
    return out + consensus.end()


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_every_frame_gets_a_matte_in_its_order(count: int) -> None:
    mattes = agreed([in_time(np.full(SHAPE, 10 * k, np.uint8)) for k in range(count)])
    assert len(mattes) == count
    levels = [int(matte.alpha[0, 0]) for matte in mattes]
    assert levels == sorted(levels)


@pytest.mark.parametrize("length", [1, 2])
def test_a_hole_of_one_or_two_frames_does_not_open(length: int) -> None:
    alphas = [skin() for _ in range(FRAMES)]
    for alpha in alphas[5 : 5 + length]:
        alpha[20:26, 20:28] = 0
    for matte in agreed([in_time(alpha) for alpha in alphas]):
        np.testing.assert_array_equal(matte.alpha, skin())
        np.testing.assert_array_equal(matte.mask, skin() > 0)


@pytest.mark.parametrize("length", [1, 2])
def test_a_patch_of_one_or_two_frames_is_not_taken_in(length: int) -> None:
    alphas = [skin() for _ in range(FRAMES)]
    for alpha in alphas[5 : 5 + length]:
        alpha[20:40, 40:48] = 255
    for matte in agreed([in_time(alpha) for alpha in alphas]):
        assert matte.alpha[:, 43:].max() == 0


@pytest.mark.parametrize("length", [1, 2])
def test_a_narrow_strip_does_not_open_where_the_picture_is_alike(length: int) -> None:
    strip = np.zeros(SHAPE, np.uint8)
    strip[10:50, 20:25] = 255
    alphas = [strip.copy() for _ in range(FRAMES)]
    for alpha in alphas[5 : 5 + length]:
        alpha[25:35] = 0
    for matte in agreed([in_time(alpha) for alpha in alphas]):
        np.testing.assert_array_equal(matte.alpha, strip)


def test_an_edge_that_shakes_stays_with_its_picture() -> None:
    """A box may be a cell off for a frame."""
    alphas = [np.roll(skin(), k % 2, axis=1) for k in range(FRAMES)]
    frames = [in_time(alpha, np.repeat(alpha[..., None], 3, axis=2)) for alpha in alphas]
    for matte, alpha in zip(agreed(frames), alphas, strict=True):
        np.testing.assert_array_equal(matte.alpha, alpha)


def test_a_hole_of_three_frames_opens_when_it_does() -> None:
    alphas = [skin() for _ in range(FRAMES)]
    for alpha in alphas[5:8]:
        alpha[20:30, 20:30] = 0
    opened = [matte.alpha[25, 25] == 0 for matte in agreed([in_time(alpha) for alpha in alphas])]
    assert opened == [5 <= k < 8 for k in range(FRAMES)]


def test_an_edge_that_moves_stays_where_it_is() -> None:
    alphas = [np.roll(skin(), k, axis=1) for k in range(FRAMES)]
    for matte, alpha in zip(agreed([in_time(alpha) for alpha in alphas]), alphas, strict=True):
        np.testing.assert_array_equal(matte.alpha, alpha)


def test_what_the_picture_shows_to_pass_is_cut_out_however_short() -> None:
    alphas, pictures = [skin() for _ in range(FRAMES)], [np.full((*SHAPE, 3), 120, np.uint8) for _ in range(FRAMES)]
    alphas[5][15:30, 15:30], pictures[5][15:30, 15:30] = 0, 20
    mattes = agreed([in_time(*pair) for pair in zip(alphas, pictures, strict=True)])
    np.testing.assert_array_equal(mattes[5].alpha, alphas[5])
    np.testing.assert_array_equal(mattes[6].alpha, skin())


def test_a_thin_thing_of_another_hue_is_cut_out_however_short() -> None:
    alphas, pictures = [skin() for _ in range(FRAMES)], [np.full((*SHAPE, 3), 120, np.uint8) for _ in range(FRAMES)]
    occluders = [np.zeros(SHAPE, np.float32) for _ in range(FRAMES)]
    alphas[5][15:40, 20:23], pictures[5][15:40, 20:23], occluders[5][15:40, 20:23] = 0, (120, 140, 100), 1
    mattes = agreed([in_time(*frame) for frame in zip(alphas, pictures, occluders, strict=True)])
    assert mattes[5].alpha[15:40, 20:23].max() == 0


def test_a_matte_ends_a_cell_beyond_the_pictures_edge_and_its_mask_at_the_edge() -> None:
    everywhere = replace(in_time(np.full(SHAPE, 255, np.uint8)), visible=np.arange(SHAPE[1]) < 20 + np.zeros(SHAPE))
    matte = everywhere.matte(everywhere.alpha, everywhere.mask)
    assert matte.alpha[:, :21].min() == 255
    assert not matte.alpha[:, 21:].any()
    assert matte.mask[:, :20].all()
    assert not matte.mask[:, 20:].any()
