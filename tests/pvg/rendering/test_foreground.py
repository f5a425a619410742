from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pvg.membrane import Lattice
from pvg.rendering._foreground_kernels import least_around
from pvg.rendering.correction import Correction
from pvg.rendering.foreground import foreground
from pvg.rendering.plane_samples import OverChroma, over_chroma
from pvg.rendering.planes import apply_correction
from pvg.video import PixelFormat
from tests.gallery.pictures import FORMATS, frame_of
from tests.pvg.rendering.test_planes import tables

SIDE, STEP = 96, 3.0
SKIN, HAIR = np.array((170.0, 130.0, 110.0)), np.array((30.0, 26.0, 24.0))


def edge() -> np.ndarray:
    """A matte that falls from 1 on the left to 0 on the right, over some cells."""
    return np.tile(np.clip((60 - np.arange(SIDE)) / 15, 0, 1), (SIDE, 1)).astype(np.float32)


def mixed(alpha: np.ndarray, behind: np.ndarray) -> np.ndarray:
    return alpha[..., None] * SKIN + (1 - alpha[..., None]) * behind


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
@pytest.mark.parametrize("behind", [HAIR, np.array((240.0, 240.0, 236.0))], ids=["hair", "wall"])
def test_what_an_edge_shows_is_the_skin_beside_it(pixel_format: PixelFormat, behind: np.ndarray) -> None:
    alpha = edge()
    frame = frame_of(mixed(alpha, behind), pixel_format)
    shown = replace(frame, planes=foreground(frame, (0, 0), alpha, STEP).planes).rgb()
    band = (alpha > 0.1) & (alpha < 0.97)
    off, before = np.abs(shown - SKIN)[band], np.abs(frame.rgb() - SKIN)[band]
    assert off.max() < 0.2 * np.abs(behind - SKIN).max()
    assert off.mean() < 0.25 * before.mean()  # the mean of α² (1 − α) over that of 1 − α is a sixth


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_inside_and_outside_of_a_matte_everything_is_as_it_was(pixel_format: PixelFormat) -> None:
    alpha = edge()
    rng = np.random.default_rng(0)
    frame = frame_of(rng.uniform(20, 230, (SIDE, SIDE, 3)), pixel_format)
    for p, (plane, shown) in enumerate(zip(frame.planes, foreground(frame, (0, 0), alpha, STEP).planes, strict=True)):
        outwards = np.roll(alpha, -1, axis=1)  # of a pixel and those around it, the one with least of skin
        whole, deep = (
            over_chroma(each, pixel_format) if p and not pixel_format.is_rgb else each for each in (alpha, outwards)
        )
        whole = (whole == 0) | (deep >= 0.97)
        np.testing.assert_array_equal(shown[whole], plane[whole])
        assert (shown != plane)[~whole].mean() > 0.8
    island = np.zeros((SIDE, SIDE), np.float32)
    island[40:44, 40:44] = 0.6  # nothing near it is surely skin
    for plane, shown in zip(frame.planes, foreground(frame, (0, 0), island, STEP).planes, strict=True):
        np.testing.assert_array_equal(shown, plane)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_the_outermost_sure_skin_shows_nothing_of_a_wall_that_a_lens_mixed_in(pixel_format: PixelFormat) -> None:
    alpha = np.tile((np.arange(SIDE) < 50).astype(np.float32), (SIDE, 1))
    true = alpha.copy()
    true[:, 49] = 0.8
    frame = frame_of(mixed(true, np.full(3, 240.0)), pixel_format)
    shown = replace(frame, planes=foreground(frame, (0, 0), alpha, STEP).planes).rgb()[48, 49].astype(float)
    luma = np.array((0.299, 0.587, 0.114))
    assert abs((frame.rgb()[48, 49] - SKIN) @ luma) > 15
    assert abs((shown - SKIN) @ luma) < 3


@pytest.mark.parametrize("step", [3.0, 8.0, 16.0])
@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_even_skin_stays_even_wherever_nothing_tells_of_skin_nearby(pixel_format: PixelFormat, step: float) -> None:
    """In large pictures cells are large, and of 16 bits a mean is: next to an unknown one it is not known."""
    side = 6 * SIDE
    alpha = np.tile(np.clip((side / 2 - np.arange(side)) / (6 * step), 0, 1), (side, 1)).astype(np.float32)
    alpha[: side // 3] *= 0.9  # nowhere sure
    frame = frame_of(np.full((side, side, 3), 200.0), pixel_format)
    shown = replace(frame, planes=foreground(frame, (0, 0), alpha, step).planes).rgb()
    assert np.abs(shown.astype(int) - frame.rgb()).max() <= 1


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_an_edge_changes_by_its_share_of_what_the_skin_changes(pixel_format: PixelFormat) -> None:
    """Skin that a map dims is dimmed between the hairs of a fringe too, which the map by itself would brighten."""
    alpha = edge()
    frame = frame_of(mixed(alpha, HAIR), pixel_format)
    lattice = Lattice.over((0, 0, SIDE, SIDE), target_height=12)
    none = np.zeros((3, lattice.height, lattice.width), np.float32)
    correction = Correction(lattice, none, tables(pixel_format, slope=0.4))
    luma = np.array((0.299, 0.587, 0.114))
    wanted = alpha[48] * -0.6 * (SKIN @ luma - 100)
    off = {}
    for skin in (None, foreground(frame, (0, 0), alpha, STEP)):
        drawn = frame.patched(apply_correction(frame, (0, 0), alpha, correction, skin=skin))
        off[skin is None] = np.abs((drawn.rgb()[48] - frame.rgb()[48].astype(float)) @ luma - wanted).max()
    assert off[False] < 0.5 * off[True]


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_a_wall_under_a_matte_that_is_too_large_neither_shines_nor_takes_another_hue(pixel_format: PixelFormat) -> None:
    """Skin is made as bright as the wall, and half as red: between them little is brighter, and nothing less red."""
    alpha = edge()
    true = (alpha >= 0.97).astype(np.float32)
    wall, luma_of_skin = np.full(3, 170.0), float(SKIN @ np.array((0.299, 0.587, 0.114)))
    frame = frame_of(mixed(true, wall), pixel_format)
    skin = foreground(frame, (0, 0), alpha, STEP)
    lattice = Lattice.over((0, 0, SIDE, SIDE), target_height=12)
    gain = pixel_format.opponent.matrix @ (np.array((190.0, 160.0, 150.0)) - SKIN)
    shift = np.float32(gain)[:, None, None] * np.ones((1, lattice.height, lattice.width), np.float32)
    drawn = frame.patched(
        apply_correction(frame, (0, 0), alpha, Correction(lattice, shift, tables(pixel_format)), skin=skin)
    )
    row = drawn.rgb()[48].astype(float)
    luma = row @ np.array((0.299, 0.587, 0.114))
    bright, red = luma[:8].mean(), row[:8, 0].mean() - luma[:8].mean()
    gain_of_red = red - (SKIN[0] - luma_of_skin)  # less than 0
    assert bright > 155
    assert red > 12
    # where the matte is nearly sure, skin cannot be told from the wall
    thin = (alpha[48] > 0.2) & (alpha[48] < 0.7)
    unbounded = 170 + alpha[48] * (bright - luma_of_skin)
    assert (luma - 170)[thin].mean() < 0.6 * (unbounded - 170)[thin].mean()
    assert (row[:, 0] - luma)[thin].mean() > 0.6 * (alpha[48] * gain_of_red)[thin].mean()


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_an_edge_loses_its_chroma_as_the_skin_does(pixel_format: PixelFormat) -> None:
    """Else what is diluted there, and no redder than the new skin, would stay as it was: a rim of the old colour."""
    alpha, weights = edge(), np.array((0.299, 0.587, 0.114))
    skin_red, hair = SKIN - SKIN @ weights, np.full(3, 45.0)
    frame = frame_of(mixed(alpha, hair), pixel_format)
    lattice = Lattice.over((0, 0, SIDE, SIDE), target_height=12)
    shift = np.float32(pixel_format.opponent.matrix @ (-0.6 * skin_red))
    nodes = shift[:, None, None] * np.ones((1, lattice.height, lattice.width), np.float32)
    skin = foreground(frame, (0, 0), alpha, STEP)
    drawn = frame.patched(
        apply_correction(frame, (0, 0), alpha, Correction(lattice, nodes, tables(pixel_format)), skin=skin)
    )
    before, after = (
        row[:, 0] - row @ weights for row in (frame.rgb()[48].astype(float), drawn.rgb()[48].astype(float))
    )
    band = (alpha[48] > 0.3) & (alpha[48] < 0.9)
    np.testing.assert_allclose(after[band], 0.4 * before[band], atol=3)
    np.testing.assert_array_equal(after[alpha[48] == 0], before[alpha[48] == 0])


def test_the_least_of_a_matte_around_a_pixel_is_that_of_an_erosion_by_one() -> None:
    rng, hardly = np.random.default_rng(0), np.float32(1e-4)
    for shape in ((1, 1), (1, 40), (40, 1), (70, 90), (33, 200)):
        alpha = np.clip(cv2.GaussianBlur(rng.normal(0.3, 4, shape).astype(np.float32), (0, 0), 3), 0, 1)
        alpha[: shape[0] // 3, : shape[1] // 2] = 0
        beta = np.full(shape, np.nan, np.float32)
        least_around(alpha, hardly, beta)
        wanted = np.maximum(cv2.erode(alpha, np.ones((3, 3), np.uint8)), np.minimum(alpha, hardly))
        np.testing.assert_array_equal(beta, wanted)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_a_weight_is_averaged_over_chroma_once_for_all_looks(pixel_format: PixelFormat) -> None:
    over, (one, other) = OverChroma(pixel_format), np.random.default_rng(0).random((2, 7, 9), np.float32)
    for weight in (one, other, one):
        np.testing.assert_array_equal(over(weight), over_chroma(weight, pixel_format))
    assert over(one) is over(one)
