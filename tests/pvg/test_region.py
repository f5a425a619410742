"""Square regions: what is upright in them, what they read, and what lies beyond the picture."""

from __future__ import annotations

import numpy as np
import pytest

from pvg.picture import RgbPicture
from pvg.region import Region


def _ramps(height: int, width: int) -> RgbPicture:
    """A picture whose red is the column, green the row and blue 50."""
    y, x = np.mgrid[:height, :width]
    return RgbPicture(np.stack([x, y, np.full_like(x, 50)], axis=-1).astype(np.uint8))


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.2])
@pytest.mark.parametrize("pixels", [32, 64])
def test_a_region_reads_what_lies_there(angle: float, pixels: int) -> None:
    region = Region(100.0, 90.0, 64.0, angle)
    shown = region.read(_ramps(200, 220), pixels).astype(float)
    at = np.array([[(pixels - 1) / 2, (pixels - 1) / 2, 1], [2, 5, 1], [pixels - 3, pixels - 7, 1]])
    places = at @ region.to_source(pixels).T
    assert places[0] == pytest.approx((100, 90))
    # down in the region is down in the picture, turned
    down = region.to_source(pixels)[:, 1]
    assert down == pytest.approx(np.array([-np.sin(angle), np.cos(angle)]) * 64 / pixels)
    for (x, y, _), place in zip(at[1:].astype(int), places[1:], strict=True):
        np.testing.assert_allclose(shown[y, x, :2], place, atol=1.5)


def test_a_large_region_is_averaged_and_not_picked() -> None:
    stripes = np.zeros((300, 300, 3), np.uint8)
    stripes[:, ::2] = 200
    shown = Region(150.0, 150.0, 256.0, 0.0).read(RgbPicture(stripes), 64)
    np.testing.assert_allclose(shown, 100, atol=1)


def test_beyond_the_picture_its_edge_is_repeated() -> None:
    shown = Region(0.0, 50.0, 64.0, 0.0).read(_ramps(100, 120), 64)
    assert (shown[:, :30, 0] == 0).all()
    assert (shown[:, :30, 2] == 50).all()
