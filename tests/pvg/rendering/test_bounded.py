"""What ears and hands have beyond the usual chroma is bounded alike in all formats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.looks import LookMap, SkinMap
from pvg.rendering.bounded import beyond_bound_of_means
from pvg.rendering.coding import Coding
from pvg.rendering.map_tables import MapTables
from pvg.video import RGB24, PixelFormat, named_space

SKIN, CRIMSON = np.array([190.0, 140.0, 110.0]), np.array([25.0, -10.0, 0.0])
SDR = PixelFormat("yuv420p", 8, (1, 1), (0.299, 0.114), False)
DEEP = PixelFormat("yuv420p10le", 10, (1, 1), (0.2627, 0.0593), False)
HDR = [replace(DEEP, color=named_space(name)) for name in ("hlg", "pq", "slog3", "logc3")]
ONCE = np.ones((1, 5), np.float32)


def kept(goal: tuple[float, float, float], pixel_format: PixelFormat, excess: np.ndarray) -> float:
    """How much of what an ear is apart from its skin is left, over what a map without bounds leaves of it."""
    light = 1 + 0.06 * np.random.default_rng(0).normal(0, 1, (400, 1))
    look = LookMap(SkinMap.between((SKIN * light).astype(np.float32), np.array(goal) * light), 1.0, ONCE)
    tables = MapTables.of(look, pixel_format, region="beside")
    colors = np.stack([SKIN, SKIN + excess]).astype(np.float32)
    codes = np.asarray(Coding(pixel_format).colors(colors) + tables.offset, np.float32)
    codes[:, 0] = codes[0, 0]  # the usual chroma is that of its luma
    of_skin, of_ear = beyond_bound_of_means(tables, codes).T
    apart = tables.broad * np.hypot(*(codes[1] - codes[0])[1:])
    return 1.0 - float(np.hypot(*(of_ear - of_skin))) / max(apart, 1e-9)


@pytest.mark.parametrize("pixel_format", [DEEP, RGB24, *HDR], ids=lambda one: f"{one.name} {one.color and 'HDR'}")
def test_a_crimson_ear_is_bounded_alike_in_all_formats(pixel_format: PixelFormat) -> None:
    assert kept((205, 175, 155), pixel_format, CRIMSON) == pytest.approx(kept((205, 175, 155), SDR, CRIMSON), abs=0.12)


@pytest.mark.parametrize("pixel_format", [SDR, *HDR], ids=lambda one: f"{one.name} {one.color and 'HDR'}")
def test_what_differs_a_little_stays(pixel_format: PixelFormat) -> None:
    assert kept((205, 175, 155), pixel_format, 0.15 * CRIMSON) > 0.9


def test_beside_a_face_that_stays_as_it_is_there_is_no_bound() -> None:
    assert kept(tuple(SKIN), SDR, CRIMSON) == pytest.approx(1.0, abs=1e-6)


def test_without_strength_nothing_is_taken_away() -> None:
    light = np.linspace(0.9, 1.1, 50)[:, None]
    look = LookMap(SkinMap.between((SKIN * light).astype(np.float32), (1.2 * SKIN - 20) * light), 0.0, ONCE)
    tables = MapTables.of(look, SDR, region="beside")
    assert tables.bound.max() > 0
    np.testing.assert_array_equal(beyond_bound_of_means(tables, np.array([[150.0, 100.0, 200.0]], np.float32)), 0)
