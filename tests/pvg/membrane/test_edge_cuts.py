"""Where curves cut the lattice."""

from __future__ import annotations

import numpy as np
import pytest

from pvg.membrane import Lattice, cut_edges


def test_an_inactive_sample_takes_its_two_segments_out() -> None:
    points = np.array([[5.0, 5.0], [30.0, 6.0], [31.0, 30.0], [6.0, 31.0], [20.0, 20.0]])
    active = np.array([True, False, True, True, True])
    lattice = Lattice.over((0, 0, 40, 40))
    partial = cut_edges(points, [(0, 4, True)], lattice, active=active)
    rest = cut_edges(points[[2, 3, 0]], [(0, 3, False)], lattice)
    np.testing.assert_array_equal(partial.theta, rest.theta)
    values = np.arange(5.0)[:, None]
    np.testing.assert_array_equal(partial.values(values), rest.values(values[[2, 3, 0]]))


def test_curves_of_the_wrong_shape_or_value_are_refused() -> None:
    lattice = Lattice.over((0, 0, 30, 30))
    with pytest.raises(ValueError, match="finite"):
        cut_edges([[0.0, np.nan]], [(0, 1, False)], lattice)
    with pytest.raises(ValueError, match="leaves the 1 samples"):
        cut_edges([[0.0, 1.0]], [(0, 2, False)], lattice)
    with pytest.raises(ValueError, match="active"):
        cut_edges([[0.0, 1.0]], [(0, 1, False)], lattice, active=[True, False])
