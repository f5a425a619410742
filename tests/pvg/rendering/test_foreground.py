from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.membrane import Lattice
from pvg.rendering.correction import Correction
from pvg.rendering.foreground import foreground
from pvg.rendering.planes import apply_correction, over_chroma
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
    shown = replace(frame, planes=foreground(frame, (0, 0), alpha, STEP)).rgb()
    band = (alpha > 0.1) & (alpha < 0.97)
    off, before = np.abs(shown - SKIN)[band], np.abs(frame.rgb() - SKIN)[band]
    assert off.max() < 0.2 * np.abs(behind - SKIN).max()
    assert off.mean() < 0.25 * before.mean()  # the mean of α² (1 − α) over that of 1 − α is a sixth


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_inside_and_outside_of_a_matte_everything_is_as_it_was(pixel_format: PixelFormat) -> None:
    alpha = edge()
    rng = np.random.default_rng(0)
    frame = frame_of(rng.uniform(20, 230, (SIDE, SIDE, 3)), pixel_format)
    for p, (plane, shown) in enumerate(zip(frame.planes, foreground(frame, (0, 0), alpha, STEP), strict=True)):
        weight = over_chroma(alpha, pixel_format) if p and not pixel_format.is_rgb else alpha
        whole = (weight == 0) | (weight >= 0.97)
        np.testing.assert_array_equal(shown[whole], plane[whole])
        assert (shown != plane)[~whole].mean() > 0.8
    island = np.zeros((SIDE, SIDE), np.float32)
    island[40:44, 40:44] = 0.6  # nothing near it is surely skin
    for plane, shown in zip(frame.planes, foreground(frame, (0, 0), island, STEP), strict=True):
        np.testing.assert_array_equal(shown, plane)


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
