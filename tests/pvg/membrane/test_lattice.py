"""The nodes over a box and their coarser levels."""

from __future__ import annotations

import pytest

from pvg.membrane import Lattice
from pvg.membrane.lattice import flat_size, grid_levels


def test_a_box_without_pixels_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1x1"):
        Lattice.over((0, 0, 0, 10))


@pytest.mark.parametrize("box", [(0, 0, 200, 300), (17, -9, 61, 123), (5, 5, 2, 2), (3, 4, 1, 1), (0, 0, 640, 361)])
def test_the_outer_nodes_enclose_the_pixels_of_the_box(box: tuple[int, int, int, int]) -> None:
    lattice = Lattice.over(box, target_height=77)
    x, y, width, height = box
    assert (lattice.x, lattice.y) == (x, y)
    assert x + width - 1 <= lattice.x + (lattice.width - 1) * lattice.step + 1e-5
    assert y + height - 1 <= lattice.y + (lattice.height - 1) * lattice.step + 1e-5


def test_each_level_has_half_the_nodes_and_lies_behind_the_finer_one() -> None:
    levels = grid_levels(Lattice(0.0, 0.0, 1.0, 13, 22))
    assert levels.tolist() == [[0, 22, 14, 22, 13], [384, 12, 8, 11, 7], [524, 6, 4, 6, 4]]
    assert flat_size(levels) == 524 + 8 * 6
