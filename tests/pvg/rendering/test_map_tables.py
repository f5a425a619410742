"""A map of colour on every pixel of a face, u' = F(I) + H(g' − F(g)), by tables."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pvg.haze import shown_through
from pvg.looks import LookMap, Region, SkinMap
from pvg.membrane import Lattice
from pvg.rendering.coding import Coding
from pvg.rendering.correction import Correction, at_curves
from pvg.rendering.map_tables import MapTables, _at_codes
from pvg.rendering.planes import apply_correction
from pvg.video import RGB24, PixelFormat
from tests.gallery.pictures import FORMATS, YUV444, frame_of, patchwork

SIDE = 48
ONCE = np.ones((1, 5), np.float32)  # one key frame, the one that the map was made from


def skin(middle: tuple[int, int, int], spread: float = 0.3) -> np.ndarray:
    rng = np.random.default_rng(0)
    light = rng.uniform(1 - spread, 1 + spread, (400, 1))
    return np.clip(np.array(middle) * light + rng.normal(0, 3, (400, 3)), 1, 254).astype(np.float32)


def to(middle: tuple[int, int, int], spread: float = 0.3, strength: float = 1.0) -> LookMap:
    return LookMap(SkinMap.between(skin((190, 140, 110)), skin(middle, spread).astype(float)), strength, ONCE)


OWN, DARK = to((190, 140, 110)), to((90, 60, 50), 0.4)


def over_all(tables: MapTables, shift: tuple[float, float, float] = (0, 0, 0)) -> Correction:
    """The same shift everywhere."""
    lattice = Lattice.over((0, 0, SIDE, SIDE), target_height=12)
    everywhere = np.ones((1, lattice.height, lattice.width), np.float32)
    return Correction(lattice, np.array(shift, np.float32)[:, None, None] * everywhere, tables)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_a_skins_own_map_and_no_shift_change_no_bit(pixel_format: PixelFormat) -> None:
    frame = frame_of(patchwork(0), pixel_format)
    alpha = np.random.default_rng(1).random((32, 32), np.float32)
    tables = MapTables.of(OWN, pixel_format)
    for before, after in zip(
        frame.planes, frame.patched(apply_correction(frame, (8, 8), alpha, over_all(tables))).planes, strict=True
    ):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_where_the_membrane_asks_for_nothing_the_map_itself_is_drawn(pixel_format: PixelFormat) -> None:
    colors = np.array([(190, 140, 110), (150, 110, 90), (215, 165, 140)], np.float32)
    for color in colors:
        frame = frame_of(np.full((SIDE, SIDE, 3), color, np.float64), pixel_format)
        tables = MapTables.of(DARK, pixel_format)
        out = frame.patched(apply_correction(frame, (8, 8), np.ones((32, 32), np.float32), over_all(tables)))
        drawn = out.format.to_rgb(out.planes)[20, 20]
        np.testing.assert_allclose(drawn, DARK.skin(color[None])[0], atol=2.5)  # codes of 8 bits in and out


@pytest.mark.parametrize("region", ["face", "beside"])
def test_at_a_curve_the_new_colour_is_drawn_whatever_the_map(region: Region) -> None:
    """g' − F(g) is what the shift adds to F(g), so that pixels of the colour g become g'."""
    coding, tables = Coding(YUV444), MapTables.of(DARK, YUV444, region=region)
    g, new = (coding.colors(np.array([rgb], np.float32)) for rgb in ((170, 120, 95), (120, 100, 90)))
    wanted = at_curves(g, new, tables)
    frame = frame_of(np.full((SIDE, SIDE, 3), (170.0, 120.0, 95.0)), YUV444)
    correction = over_all(tables, tuple(wanted.shift[0].tolist()))
    out = frame.patched(apply_correction(frame, (8, 8), np.ones((32, 32), np.float32), correction))
    np.testing.assert_allclose(out.format.to_rgb(out.planes)[20, 20], (120, 100, 90), atol=2.0)


def test_half_of_a_look_gains_half() -> None:
    colors = Coding(YUV444).colors(skin((180, 130, 100)))
    half, whole = (MapTables.of(to((90, 60, 50), strength=s), YUV444).gained(colors) for s in (0.5, 1.0))
    np.testing.assert_allclose(half, 0.5 * whole, atol=1e-3)


def test_a_still_in_rgb_gets_what_a_clip_in_luma_and_chroma_gets() -> None:
    rgb = np.rint(patchwork(2))
    alpha = np.random.default_rng(3).random((32, 32), np.float32)
    outs = []
    for pixel_format in (RGB24, YUV444):
        frame = frame_of(rgb, pixel_format)
        tables = MapTables.of(DARK, pixel_format)
        out = frame.patched(apply_correction(frame, (8, 8), alpha, over_all(tables, (18, -9, 6))))
        outs.append(np.clip(out.format.to_rgb(out.planes), 0, 255))
    assert np.abs(outs[0] - rgb).max() > 10
    assert np.abs(outs[0] - outs[1]).mean() < 0.8
    assert np.abs(outs[0] - outs[1]).max() < 4.0  # three roundings in the one, one in the other


def test_a_table_is_read_between_codes_as_numpy_reads_it() -> None:
    rng = np.random.default_rng(0)
    for size in (256, 1024):
        table = rng.normal(0, 30, size).astype(np.float32)
        codes = np.append(rng.uniform(-9, size + 9, 500), [0, 1, size - 1, size - 2, np.nan]).astype(np.float32)
        wanted = np.interp(codes, np.arange(size), table)
        np.testing.assert_array_equal(_at_codes(codes, table), wanted)
        np.testing.assert_array_equal(_at_codes(codes.reshape(5, -1)[:, ::2], table), wanted.reshape(5, -1)[:, ::2])


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
@pytest.mark.parametrize("region", ["face", "beside"])
def test_under_haze_a_map_gains_what_haze_leaves_of_it(pixel_format: PixelFormat, region: Region) -> None:
    """P = v + (1 - v / 255) I, so a change of I is as much less in P."""
    haze, colors = 80, skin((180, 130, 100))
    clear, hazy = (MapTables.of(replace(DARK, haze=v), pixel_format, region=region) for v in (0, haze))
    gained = clear.gained(Coding(pixel_format).colors(colors))
    under = hazy.gained(Coding(pixel_format, haze).colors(colors))
    level = 2.0 ** (pixel_format.depth - 8)
    np.testing.assert_allclose(under / level, shown_through(haze) * gained / level, atol=0.8)
    assert np.abs(gained).max() > 30 * level


def test_rounding_beyond_white_is_no_direction_of_chroma() -> None:
    """Highlights of HDR skin above SDR white kept their hue in hard-edged islands."""
    usual = np.array([[-20.0, 1e-6], [30.0, -1e-6]], np.float32)
    told = np.array([[0.2, 0.2], [0.7, 0.7]], np.float32)
    tables = SimpleNamespace(usual=usual, least=np.full(2, 3.6, np.float32), told=told)
    blue, red, _ = MapTables.alikeness.func(tables)  # type: ignore[arg-type]
    assert blue[0] < 0 < red[0]
    assert (blue[1], red[1]) == (0, 0)
