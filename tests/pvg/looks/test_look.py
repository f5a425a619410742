from __future__ import annotations

import numpy as np
import pytest

from pvg.looks import Look


def colors(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (2, 7, 3)).astype(np.float32)


FIELD = np.random.default_rng(9).uniform(0.7, 1.5, (2, 7, 2)).astype(np.float32)


def test_looks_of_different_faces_become_one() -> None:
    one, two = Look({0: colors(0)}, 0.8), Look({3: colors(3)}, {3: FIELD})
    for both in (one.merged(two), two.merged(one)):
        assert set(both.colors) == {0, 3}
        assert both.contrast_of(0) == 0.8
        np.testing.assert_array_equal(both.at_curves(0, 1), one.at_curves(0, 1))
        np.testing.assert_array_equal(both.at_curves(3, 1), two.at_curves(3, 1))


def test_what_cannot_be_drawn_together_is_refused() -> None:
    with pytest.raises(ValueError, match="both looks change face 1"):
        Look({0: colors(0), 1: colors(1)}).merged(Look({1: colors(1)}))
    with pytest.raises(ValueError, match="protect"):
        Look({0: colors(0)}).merged(Look({1: colors(1)}, protect=()))
