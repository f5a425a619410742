"""How far a matte is held to the frame before."""

from __future__ import annotations

import numpy as np

from pvg.skin.in_time import weight_of_before
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
