"""The matte's edge at picture resolution."""

from __future__ import annotations

import numpy as np
import pytest

from pvg.rendering.edges import refine
from pvg.skin import Matte
from pvg.video import Frame
from pvg.video.formats import RGB24, PixelFormat

SIDE, STEP = 192, 4
SKIN, WALL = np.array([200.0, 150.0, 120.0]), np.array([60.0, 70.0, 90.0])
YUV = PixelFormat("yuv420p", 8, (1, 1), (0.2126, 0.0722), False)
DEEP = PixelFormat("yuv420p10le", 10, (1, 1), (0.2126, 0.0722), False)
XS = np.arange(SIDE, dtype=np.float32)


def frame_of(rgb: np.ndarray, pixel_format: PixelFormat = YUV) -> Frame:
    """A frame of a picture (H, W, 3), 0–255."""
    if pixel_format.is_rgb:
        first, second, third = (np.rint(rgb[..., k]).astype(np.uint8) for k in range(3))
        return Frame(0, 0, 0.0, pixel_format, (first, second, third))
    codes = rgb @ pixel_format.matrix.T + pixel_format.offset
    rounded = np.rint(codes).astype(pixel_format.dtype)
    chroma = [np.ascontiguousarray(rounded[::2, ::2, k]) for k in (1, 2)]
    return Frame(0, 0, 0.0, pixel_format, (np.ascontiguousarray(rounded[..., 0]), chroma[0], chroma[1]))


def wavy() -> np.ndarray:
    """(H, W) the share of skin: an edge that waves by less than a cell of the matte, sharp to a pixel."""
    edge = SIDE / 2 + 3.0 * np.sin(XS * 2 * np.pi / 11)
    return np.clip(edge[:, None] - XS[None, :] + 0.5, 0, 1)


def mixed(share: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Skin before a wall (H, W, 3)."""
    rgb = share[..., None] * SKIN + (1 - share[..., None]) * WALL
    return np.clip(rgb + np.random.default_rng(seed).normal(0, noise, rgb.shape), 0, 255)


def soft_matte(full: int = 255) -> Matte:
    """A matte whose cells know of a straight edge only, soft over four of them."""
    cells = SIDE // STEP
    row = np.clip((cells / 2 + 2 - np.arange(cells) - 0.5) / 4, 0, 1)
    alpha = np.rint(np.broadcast_to(row, (cells, cells)) * full).astype(np.uint8)
    return Matte.over(np.array([0, 0, SIDE, SIDE], np.float32), alpha)


def refined(rgb: np.ndarray, matte: Matte, pixel_format: PixelFormat = YUV) -> np.ndarray:
    alpha = matte.alpha_at(XS, XS)
    refine(alpha, (0, 0), matte, frame_of(rgb, pixel_format))
    return alpha


@pytest.mark.parametrize("pixel_format", [YUV, DEEP, RGB24], ids=["8 bit", "10 bit", "RGB"])
def test_an_edge_finer_than_the_cells_is_followed(pixel_format: PixelFormat) -> None:
    truth, matte = wavy(), soft_matte()
    inner = slice(16, -16)
    coarse = np.abs(matte.alpha_at(XS, XS) - truth)[inner, inner].mean()
    followed = np.abs(refined(mixed(truth), matte, pixel_format) - truth)[inner, inner].mean()
    assert followed < 0.22 * coarse


@pytest.mark.parametrize(("row", "most"), [(96, 0.25), (97, 0.52)], ids=["on one row of chroma", "on two"])
def test_a_strand_over_the_edge_stays_dark(row: int, most: float) -> None:
    truth = (XS[None, :] < SIDE / 2).astype(float) * np.ones((SIDE, 1))
    rgb = mixed(truth)
    rgb[row : row + 2, 80:] = WALL
    alpha = refined(rgb, soft_matte())
    assert alpha[row : row + 2, 92:].max() < most
    assert alpha[row - 6 : row - 3, 86:95].min() > 0.9


def test_an_edge_between_two_hues_has_no_steps() -> None:
    """Chroma has half as many samples as luma; an edge that it alone tells runs smoothly all the same."""
    place = SIDE / 2 + (XS[:, None] - SIDE / 2) / 5
    truth = np.clip((place - XS[None, :]) / 3 + 0.5, 0, 1)
    green = np.array([110.0, 176.6, 120.0])  # of the skin's luma
    rgb = truth[..., None] * SKIN + (1 - truth[..., None]) * green
    alpha = refined(rgb, soft_matte())[60:132]
    crossing = alpha.sum(axis=1)  # where each row ends, in pixels
    steps = np.diff(crossing)
    assert np.abs(steps - 0.2).max() < 0.25


@pytest.mark.parametrize(
    ("beyond", "least", "most"), [(WALL, 0.07, 0.15), (np.array([190.0, 200.0, 215.0]), -0.01, 0.02)]
)
def test_what_is_little_skin_is_skin_beside_hair_and_none_beside_a_bright_wall(
    beyond: np.ndarray, least: float, most: float
) -> None:
    """Chroma, coded coarsely, spreads over a wall, and a look that brightens would draw a line there."""
    share = np.broadcast_to(np.clip((SIDE / 2 + 4 - XS) / 16, 0, 1)[None, :], (SIDE, SIDE))  # over 16 pixels
    rgb = share[..., None] * SKIN + (1 - share[..., None]) * beyond
    little = (share > 0.05) & (share < 0.08)
    little[:16] = little[-16:] = False
    told = refined(rgb, soft_matte())[little]
    assert least < told.mean() < most


def test_where_both_sides_are_alike_the_matte_stays() -> None:
    matte = soft_matte()
    plain = np.full((SIDE, SIDE, 3), 128.0)
    np.testing.assert_allclose(refined(plain, matte), matte.alpha_at(XS, XS), atol=1e-5)


def test_away_from_the_edge_nothing_changes() -> None:
    rgb = mixed(wavy())
    rgb[40:60, 20:40], rgb[40:60, 150:170] = WALL, SKIN
    before = soft_matte().alpha_at(XS, XS)
    after = refined(rgb, soft_matte())
    np.testing.assert_array_equal(after[:, :72], before[:, :72])
    np.testing.assert_array_equal(after[:, 120:], before[:, 120:])


def test_the_opacity_of_a_face_that_is_being_lost_is_kept() -> None:
    rgb = mixed(wavy())
    np.testing.assert_allclose(refined(rgb, soft_matte(100)), refined(rgb, soft_matte()) * 100 / 255, atol=0.02)


def test_noise_hardly_moves_the_edge() -> None:
    first, second = (refined(mixed(wavy(), 2.0, seed), soft_matte()) for seed in (1, 2))
    assert np.abs(first - second)[:, 80:112].mean() < 0.01


def test_beyond_the_picture_nothing_is_read() -> None:
    alpha = soft_matte().alpha
    matte = Matte.over(np.array([-40, -40, SIDE - 40, SIDE - 40], np.float32), alpha)
    truth = (XS[None, :] + 40 < SIDE / 2).astype(float) * np.ones((SIDE, 1))
    after = matte.alpha_at(XS, XS)
    refine(after, (0, 0), matte, frame_of(mixed(truth)))
    assert np.abs(after - truth)[: SIDE - 56, : SIDE - 56].mean() < 0.01


def test_an_empty_matte_stays_empty() -> None:
    matte = Matte.over(np.array([0, 0, SIDE, SIDE], np.float32), np.zeros((48, 48), np.uint8))
    assert not refined(mixed(wavy()), matte).any()
