"""Features of another network around a head: over which square they are told, and where in it each lies."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pvg.skin.features import CHANNELS, FEATURES, SIDES, Features, features_around
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape, head_shape
from tests.gallery.scenes import drawn_face

_BODY = SKIN_PRIOR.body_network


def _head(size: float, middle: tuple[float, float]) -> HeadShape:
    """A head so large, somewhere in a scene."""
    drawn = head_shape(drawn_face(width=120, center=(160, 150)).landmarks)
    scale = size / drawn.size
    return replace(drawn, width=drawn.width * scale, height=drawn.height * scale, middle=np.array(middle, np.float32))


def _noise(shape: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (*shape, 3), np.uint8)


def test_the_square_is_some_face_sizes_wide_and_lies_within_the_scene() -> None:
    rgb = _noise((200, 256))
    found = features_around(rgb, _head(20, (128, 60)))
    assert found.side == pytest.approx(_BODY.seen_sizes * 20, rel=0.01)
    assert found.left + found.side / 2 == pytest.approx(128, abs=0.5)
    assert found.top + found.side / 2 == pytest.approx(60 + _BODY.seen_below * 20, abs=0.5)
    corner = features_around(rgb, _head(20, (250, 190)))
    assert (corner.left + corner.side, corner.top + corner.side) == (256, 200)
    # a head that fills the scene: all of it, its shorter side in the middle
    close = features_around(rgb, _head(90, (128, 60)))
    assert (close.side, close.left, close.top) == (256, 0, -28)


@pytest.mark.parametrize("size", [12.0, 20.0, 36.0])
def test_a_thing_is_seen_where_it_is(size: float) -> None:
    """Finer and coarser than the network's own pixels: what changes with a patch lies around that patch."""
    plain = np.full((180, 256, 3), 128, np.uint8)
    patch = plain.copy()
    patch[100:116, 150:174] = _noise((16, 24))
    head, columns, rows = _head(size, (140, 70)), np.arange(256) + 0.5, np.arange(180) + 0.5
    before, after = (features_around(rgb, head).over(columns, rows) for rgb in (plain, patch))
    assert before.shape == (FEATURES, 180, 256)
    change = np.abs(after - before)[:40].sum(axis=0) ** 2  # the finer ones
    middle = (change.sum(0) * columns).sum() / change.sum(), (change.sum(1) * rows).sum() / change.sum()
    assert middle == pytest.approx((162, 108), abs=2)


def test_components_are_the_same_of_maps_and_of_what_is_read_from_them() -> None:
    """They are taken of the maps, of which there are a tenth as many places, though the network was fitted to cells."""
    found = features_around(_noise((180, 256)), _head(20, (140, 70)))
    side = SIDES[1]  # of the coarser map, so that it takes what is read as well
    columns, rows = np.linspace(60, 220, side), np.linspace(20, 170, side)
    read = np.split(found.over(columns, rows), [CHANNELS[0]])[1]
    of_read = replace(found, maps=(found.maps[0], read)).components().maps[1]
    of_maps = found.components().over(columns, rows)
    assert len(of_maps) < FEATURES / 2
    np.testing.assert_allclose(of_maps[-len(of_read) :], of_read, atol=1e-4)


def test_beyond_the_square_features_are_those_of_its_edge() -> None:
    found = features_around(_noise((180, 256)), _head(12, (40, 40)))
    inside, outside = (found.over(np.array([x]), np.array([60.0])) for x in (found.left + found.side, 250.0))
    np.testing.assert_array_equal(inside, outside)


def test_what_lies_outside_the_square_counts_by_degrees_and_the_scenes_own_end_costs_nothing() -> None:
    ramp, middles = 28.0, np.arange(110, 180, 0.5)
    counts = [Features(x - 126, 0.0, 252.0, ()).inside((252, 310), ramp) for x in middles if 0 <= x - 126 <= 310 - 252]
    # as the square moves by half a cell nothing jumps
    steps = [np.abs(after - before).max() for before, after in pairwise(counts)]
    assert 0.01 < max(steps) < 1.5 / ramp
    assert counts[0][:, :200].min() == 1  # it begins where the scene does
    assert counts[0][:, 252:].max() == 0
    middle = Features(29.0, 0.0, 252.0, ()).inside((252, 310), ramp)
    assert middle[:, 29 + 28 : 29 + 252 - 28].min() == 1
    assert middle[:, :29].max() == 0
    assert (Features(-30.0, 0.0, 310.0, ()).inside((310, 250), ramp) == 1).all()
