"""Reading a solved membrane at source pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.membrane import Lattice, Membrane
from tests.pvg.membrane.scenes import values_at

LATTICE = Lattice.over((0, 0, 300, 200), target_height=57)
LATTICE_SHAPE = (LATTICE.height, LATTICE.width)


def tilted(box: tuple[int, int, int, int], target_height: int) -> Membrane:
    lattice = Lattice.over(box, target_height=target_height)
    y, x = np.mgrid[: lattice.height, : lattice.width] * lattice.step
    planes = np.stack((x + lattice.x + 2 * (y + lattice.y), 100.0 - (x + lattice.x)))
    return Membrane(lattice, planes.astype(np.float32))


@pytest.mark.parametrize("box", [(0, 0, 200, 300), (17, -9, 61, 123), (5, 5, 2, 2), (3, 4, 1, 1), (0, 0, 640, 361)])
@pytest.mark.parametrize("target_height", [20, 77, 280])
def test_a_linear_field_is_read_exactly_at_every_pixel(box: tuple[int, int, int, int], target_height: int) -> None:
    left, top, width, height = box
    y, x = np.mgrid[top : top + height, left : left + width]
    read = tilted(box, target_height).crop(*box)
    np.testing.assert_allclose(read, np.stack((x + 2 * y, 100 - x), axis=-1), atol=1e-3)


@given(st.integers(0, 299), st.integers(0, 199), st.integers(1, 80), st.integers(1, 80))
@settings(max_examples=40, deadline=None)
def test_a_crop_equals_the_same_part_of_the_whole(x: int, y: int, width: int, height: int) -> None:
    noise = np.random.default_rng(3).normal(0.0, 20.0, (3, *LATTICE_SHAPE)).astype(np.float32)
    membrane = Membrane(LATTICE, noise)
    whole = membrane.crop(0, 0, 300, 200)
    width, height = min(width, 300 - x), min(height, 200 - y)
    np.testing.assert_array_equal(membrane.crop(x, y, width, height), whole[y : y + height, x : x + width])
    np.testing.assert_allclose(values_at(membrane, np.array([[x, y]])), whole[y, x][None], atol=1e-3)
    chroma = membrane.read(np.arange(x, x + width, 2), np.arange(y, y + height, 2))
    np.testing.assert_array_equal(chroma[2], whole[y : y + height : 2, x : x + width : 2, 2])


def test_reading_between_the_nodes_equals_reading_the_points() -> None:
    membrane = Membrane(LATTICE, np.random.default_rng(4).normal(0, 20, (2, *LATTICE_SHAPE)).astype(np.float32))
    xs, ys = np.array([0.25, 7.5, 298.9, 310.0]), np.array([-4.0, 3.3, 199.0])
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(membrane.read(xs, ys).reshape(2, -1).T, values_at(membrane, points), atol=1e-3)


def test_a_linear_field_is_the_same_on_other_nodes() -> None:
    fine = Lattice.over((17, -9, 61, 123), target_height=101)
    read = tilted((17, -9, 61, 123), 40).on(fine)
    y, x = np.mgrid[: fine.height, : fine.width] * fine.step
    assert read.lattice == fine
    inside = (x <= 60) & (y <= 122)  # the outer nodes of both enclose the pixels, some by more than others
    np.testing.assert_allclose(read.planes[0][inside], (x + 17 + 2 * (y - 9))[inside], atol=1e-3)
