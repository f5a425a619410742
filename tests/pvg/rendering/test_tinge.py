from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.looks import LookMap, SkinMap
from pvg.rendering.coding import Coding
from pvg.rendering.map_tables import MapTables
from pvg.rendering.tinge import tinged, tinged_codes
from pvg.video import RGB24, RGB48, PixelFormat
from pvg.video.color import named_space
from tests.gallery.pictures import FORMATS, YUV422_10

# a logarithm makes chroma down to a sixth of what it is beside SDR's
OTHER_CODES = [
    replace(one, name=f"{one.name} {name}", color=named_space(name))
    for name in ("vlog", "logc4", "pq", "hlg")
    for one in (YUV422_10, RGB48)
]
ONCE = np.ones((1, 5), np.float32)


def _skin(color: tuple[float, float, float]) -> np.ndarray:
    light = np.random.default_rng(0).uniform(0.7, 1.2, (300, 1))
    return (np.array(color) * light).astype(np.float32)


def _tables(pixel_format: PixelFormat, color: tuple[float, float, float] = (190, 140, 115)) -> MapTables:
    own = _skin(color)
    return MapTables.of(LookMap(SkinMap.between(own, 0.8 * own.astype(float)), 1.0, ONCE), pixel_format)


def _share(
    pixel_format: PixelFormat, *colors: tuple[float, float, float], tables: MapTables | None = None
) -> np.ndarray:
    codes = Coding(pixel_format).colors(np.array(colors, np.float32)) + pixel_format.opponent.offset
    whole = np.ones((1, len(colors)), np.float32)
    return tinged_codes(tables or _tables(pixel_format), codes.astype(np.float32)[None], whole)[0]


@pytest.mark.parametrize("pixel_format", [*FORMATS, *OTHER_CODES], ids=lambda f: f.name)
def test_skin_in_any_shade_moves_wholly_and_grey_not_at_all(pixel_format: PixelFormat) -> None:
    skin = _share(pixel_format, (190, 140, 115), (220, 162, 133), (95, 70, 58), (210, 120, 110))
    grey = _share(pixel_format, (150, 150, 150), (90, 90, 92), (230, 230, 230), (120, 130, 150))
    np.testing.assert_allclose(skin, 1.0, atol=1e-4)
    np.testing.assert_allclose(grey, 0.0, atol=0.05)


def test_between_grey_and_skin_the_share_rises_without_a_step() -> None:
    grey, skin = np.full(3, 150.0), np.array([190.0, 140.0, 115.0])
    mixed = _share(RGB24, *(tuple(grey + t * (skin - grey)) for t in np.linspace(0, 1, 60)))  # type: ignore[misc]
    assert (np.diff(mixed) >= -1e-6).all()
    assert np.diff(mixed).max() < 0.08
    assert (mixed[0], mixed[-1]) == (pytest.approx(0.0, abs=0.01), 1.0)


def test_a_film_in_grey_is_coloured_as_a_whole() -> None:
    grey = _tables(RGB24, (150, 150, 150))
    np.testing.assert_allclose(_share(RGB24, (150, 150, 150), (60, 60, 60), (152, 150, 149), tables=grey), 1.0)


def test_chroma_at_half_size_is_told_by_the_luma_over_it() -> None:
    """Of the codes of luma the sample itself counts; an odd side has no neighbour."""
    tables = _tables(next(f for f in FORMATS if f.chroma_log2 == (1, 1) and f.depth == 8))
    luma = np.full((5, 7), 20, np.uint8)
    luma[::2, ::2] = 150
    chroma = tuple(np.full((3, 4), tables.offset[p] + tables.usual[p - 1, 150], np.uint8) for p in (1, 2))
    alpha = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    np.testing.assert_allclose(tinged(tables, luma, chroma, alpha), alpha)  # type: ignore[arg-type]


LAMP, SKY = (205.0, 130.0, 95.0), (150.0, 142.0, 158.0)


def test_skin_between_a_lamp_and_the_sky_moves_wholly() -> None:
    """The usual chroma is that of neither half."""
    own = np.concatenate([_skin(LAMP)[:180], _skin(SKY)[:120]])
    tables = MapTables.of(LookMap(SkinMap.between(own, 0.8 * own.astype(float)), 1.0, ONCE), RGB24)
    assert _share(RGB24, SKY)[0] < 0.1
    assert _share(RGB24, LAMP, SKY, tables=tables).min() > 0.9


def test_skin_that_is_burnt_out_takes_the_new_colour_wholly() -> None:
    light = np.linspace(0.9, 2.2, 400)[:, None]
    own = np.minimum(np.array((190.0, 140.0, 115.0)) * light, 255.0).astype(np.float32)
    brown = np.tile(np.array((150.0, 100.0, 75.0)), (400, 1)) * np.linspace(0.8, 1.2, 400)[:, None]
    skin = SkinMap.between(own, brown)
    tables = MapTables.of(LookMap(skin, 1.0, ONCE), RGB24)
    burnt = ((255.0, 255.0, 255.0), (255.0, 255.0, 251.0), (255.0, 254.0, 246.0))
    assert _share(RGB24, *burnt, tables=tables).min() > 0.9
    moved = skin(np.array(burnt, np.float32))
    assert (moved[:, 0] - moved[:, 2]).min() > 30  # brown, not grey
    assert np.ptp(moved, axis=0).max() < 12  # and of one colour


def _under_a_sky(pixel_format: PixelFormat, beard: float = 0.0) -> MapTables:
    """A face a sixth of which lies at the edge of a sky's blue shade."""
    own, shade = _skin((190, 140, 115)), np.array((110, 101, 108), np.float32)
    own[250:] += np.linspace(0, 1, 50, dtype=np.float32)[:, None] * (shade - own[250:])
    look_map = LookMap(SkinMap.between(own, 0.8 * own.astype(float)), 1.0, ONCE, beard)
    return MapTables.of(look_map, pixel_format)


SHADE = (107.0, 100.0, 107.0), (111.0, 107.0, 114.0), (124.0, 116.0, 121.0)
NO_SHADE = (245.0, 245.0, 248.0), (46.0, 44.0, 48.0), (154.0, 192.0, 209.0)  # a collar, black hair and the sky


@pytest.mark.parametrize("pixel_format", [*FORMATS, *OTHER_CODES], ids=lambda f: f.name)
def test_skin_in_the_blue_shade_of_a_sky_moves_and_hair_and_collars_do_not(pixel_format: PixelFormat) -> None:
    tables = _under_a_sky(pixel_format)
    assert _share(pixel_format, *SHADE, tables=tables).min() > 0.8
    elsewhere = _share(pixel_format, *NO_SHADE)  # white is told worst, where little chroma is usual
    np.testing.assert_allclose(_share(pixel_format, *NO_SHADE, tables=tables), elsewhere, atol=0.06)


def test_what_is_as_grey_as_such_shade_stays_where_no_skin_is_in_it() -> None:
    assert _share(RGB24, *SHADE, *NO_SHADE, (120.0, 120.0, 120.0)).max() < 0.05


def test_a_grey_beard_under_a_sky_stays_grey() -> None:
    beard = ((95.0, 93.0, 98.0), (104.0, 103.0, 106.0))
    assert _share(RGB24, *beard, tables=_under_a_sky(RGB24)).min() > 0.8
    assert _share(RGB24, *beard, tables=_under_a_sky(RGB24, beard=1.0)).max() < 0.1
