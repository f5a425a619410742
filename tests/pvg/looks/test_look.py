from __future__ import annotations

import numpy as np
import pytest

from pvg.looks import Look


def colors(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (2, 7, 3)).astype(np.float32)


def test_looks_of_different_faces_become_one() -> None:
    one, two = Look({0: colors(0)}, 0.8), Look({3: colors(3)}, {3: "map"})
    for both in (one.merged(two), two.merged(one)):
        assert set(both.colors) == {0, 3}
        assert both.contrast_of(0) == 0.8
        assert both.contrast_of(3) == "map"
        np.testing.assert_array_equal(both.colors[0], one.colors[0])
        np.testing.assert_array_equal(both.colors[3], two.colors[3])


def test_what_cannot_be_drawn_together_is_refused() -> None:
    with pytest.raises(ValueError, match="both looks change face 1"):
        Look({0: colors(0), 1: colors(1)}).merged(Look({1: colors(1)}))
    with pytest.raises(ValueError, match="protect"):
        Look({0: colors(0)}).merged(Look({1: colors(1)}, protect=()))
    with pytest.raises(ValueError, match="different clips"):
        Look({0: colors(0)}, source_sha256="a").merged(Look({1: colors(1)}, source_sha256="b"))
