"""How far a matte is held to the frame before."""

from __future__ import annotations

import numpy as np

from pvg.skin.in_time import SkinInTime, held, weight_of_before
from pvg.skin.parameters import SKIN_PRIOR


def test_nothing_is_held_where_a_hand_leaves_a_wall_of_its_brightness() -> None:
    wall = np.tile(np.array((111, 99, 84), np.uint8), (20, 40, 1))
    was = wall.copy()
    was[:, 20:] = (140, 98, 77)
    held = weight_of_before(was, wall)
    assert held.shape == (20, 40)
    assert held[:, 24:].max() < 0.05
    np.testing.assert_allclose(held[:, :16], SKIN_PRIOR.tracking.keep, atol=1e-6)


def test_noise_ends_little_of_what_is_held() -> None:
    rng = np.random.default_rng(0)
    was, now = (np.clip(rng.normal(120, 2, (20, 40, 3)), 0, 255).astype(np.uint8) for _ in range(2))
    assert weight_of_before(was, now).mean() > 0.75 * SKIN_PRIOR.tracking.keep


def likely_cells(probability: np.ndarray, likely: np.ndarray) -> np.ndarray:
    return likely


def test_skin_is_held_to_the_frame_before_by_the_weight_that_each_cell_has() -> None:
    bright, dark = (np.full((20, 40), value, np.float32) for value in (0.8, 0.3))
    _, before = held(bright, None, likely_cells, 1.0)
    np.testing.assert_array_equal(before.probability, bright)
    assert before.mask.all()
    keep = np.zeros((20, 40), np.float32)
    keep[:, :20] = 0.9
    mask, now = held(dark, (before, keep), likely_cells, 1.0)
    np.testing.assert_allclose(now.probability[:, :20], 0.3 + 0.9 * 0.5, atol=1e-6)
    np.testing.assert_array_equal(now.probability[:, 20:], dark[:, 20:])
    assert mask[:, :20].all()
    assert not mask[:, 20:].any()
    assert now.alpha[:, :16].min() > 0.9
    assert now.alpha[:, 24:].max() == 0


def test_a_cell_stays_what_it_was_while_neither_is_likelier() -> None:
    """Else masks would flicker along an edge that trembles about one half."""
    half, keep = np.full((20, 40), 0.5, np.float32), np.full((20, 40), 0.9, np.float32)
    for was in (0.0, 1.0):
        whole = np.full((20, 40), was, np.float32)
        mask, _ = held(half, (SkinInTime(half, whole, whole), keep), likely_cells, 1.0)
        assert (mask == bool(was)).all()
