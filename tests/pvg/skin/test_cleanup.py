"""Connected components, holes, and the minimum cut."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pvg.skin.cleanup import fill_holes, largest_component, occupied
from pvg.skin.graph_cut import minimum_cut

masks = hnp.arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12)))


@given(masks)
@settings(deadline=None)
def test_the_largest_component_is_connected_and_no_other_is_larger(mask: np.ndarray) -> None:
    largest = largest_component(mask)
    assert (largest <= mask).all()
    if mask.any():
        assert cv2.connectedComponents(largest.astype(np.uint8), connectivity=4)[0] == 2
        _, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
        assert largest.sum() == stats[1:, cv2.CC_STAT_AREA].max()


def test_a_smaller_component_is_taken_if_it_alone_touches_the_face() -> None:
    mask = np.zeros((6, 9), np.bool_)
    mask[:, :4], mask[2, 6:8] = True, True
    near = np.zeros_like(mask)
    near[2, 7] = True
    assert largest_component(mask, near).sum() == 2
    assert largest_component(mask).sum() == 24


@given(masks)
@settings(deadline=None)
def test_holes_are_filled_and_nothing_else(mask: np.ndarray) -> None:
    filled = fill_holes(mask)
    assert (mask <= filled).all()
    background = np.pad(~filled, 1, constant_values=True).astype(np.uint8)
    assert cv2.connectedComponents(background, connectivity=4)[0] == 2
    np.testing.assert_array_equal(fill_holes(filled), filled)


def test_the_cut_follows_the_edge_where_the_log_odds_are_weak() -> None:
    rgb = np.full((24, 24, 3), 60, np.uint8)
    rgb[:, 13:] = (220, 190, 170)
    log_odds = np.full((24, 24), -6.0, np.float32)
    log_odds[:, 14:], log_odds[:, 11:14] = 6.0, 0.02  # the edge lies two columns further right than their sign says
    np.testing.assert_array_equal(minimum_cut(rgb, log_odds)[12], np.arange(24) >= 13)


def test_the_cut_leaves_certain_cells_alone() -> None:
    rgb = np.random.default_rng(0).integers(0, 255, (20, 20, 3), dtype=np.uint8)
    log_odds = np.where(np.arange(400).reshape(20, 20) % 2, 7.0, -7.0).astype(np.float32)
    np.testing.assert_array_equal(minimum_cut(rgb, log_odds), log_odds > 0)


def test_a_box_is_around_all_that_is_there_and_none_where_nothing_is() -> None:
    cells = np.zeros((9, 12), np.uint8)
    assert cells[occupied(cells, 2)].size == 0
    cells[0, 5] = cells[4, 7] = 1
    assert cells[occupied(cells)].shape == (5, 3)
    assert cells[occupied(cells, 1)].shape == (6, 5)
    cells[:] = 1
    assert cells[occupied(cells, 3)].shape == cells.shape
