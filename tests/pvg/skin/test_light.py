from __future__ import annotations

import numpy as np
import pytest

from pvg.skin.light import MID_GREY, face_color, median_color


@pytest.mark.parametrize("cells", [1, 2, 7, 300, 301])
@pytest.mark.parametrize("levels", [(0, 256), (250, 256), (0, 3), (40, 41)])
def test_the_median_of_levels_is_that_of_sorted_ones(cells: int, levels: tuple[int, int]) -> None:
    rng = np.random.default_rng(cells)
    rgb = rng.integers(*levels, (20, 31, 3)).astype(np.uint8)
    sample = np.zeros((20, 31), np.bool_)
    sample.flat[rng.choice(sample.size, cells, replace=False)] = True
    np.testing.assert_array_equal(median_color(rgb, sample), np.median(rgb[sample], axis=0))


def test_where_nothing_of_a_face_is_seen_its_colour_is_grey() -> None:
    rgb, nothing = np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.bool_)
    assert median_color(rgb, nothing) is None
    np.testing.assert_array_equal(face_color(rgb, nothing), np.full(3, MID_GREY, np.float32))
