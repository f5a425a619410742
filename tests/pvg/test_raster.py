from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.raster import (
    Raster,
    block,
    cell_at,
    cell_center,
    cell_middle,
    centers_in_unit,
    first_reading,
    from_edge,
    on_copy,
    scaled,
    scaled_affine,
    sites,
    square,
    to_edge,
)

corners = st.tuples(st.floats(-200, 200), st.floats(-200, 200))
steps = st.floats(0.5, 9)
shapes = st.tuples(st.integers(2, 60), st.integers(2, 60))


def raster_at(corner: tuple[float, float], step: float, shape: tuple[int, int]) -> Raster:
    return Raster(np.array(corner, np.float32), step, shape)


@given(corners, steps, shapes)
def test_the_centres_of_cells_are_their_own_numbers(
    corner: tuple[float, float], step: float, shape: tuple[int, int]
) -> None:
    raster = raster_at(corner, step, shape)
    x, y = raster.centers()
    cells = raster.to_cells(np.stack(np.meshgrid(x, y), axis=-1))
    rows, columns = np.indices(shape)
    np.testing.assert_allclose(cells[..., 0], columns, atol=1e-3)
    np.testing.assert_allclose(cells[..., 1], rows, atol=1e-3)


def test_cells_of_one_pixel_are_the_pixels() -> None:
    raster = raster_at((3, 5), 1.0, (4, 6))
    x, y = raster.centers()
    np.testing.assert_array_equal(x, np.arange(3, 9))
    np.testing.assert_array_equal(y, np.arange(5, 9))
    np.testing.assert_array_equal(raster.box, [3, 5, 9, 9])


@given(corners, steps, shapes)
def test_a_raster_over_its_own_box_is_itself(corner: tuple[float, float], step: float, shape: tuple[int, int]) -> None:
    raster = raster_at(corner, step, shape)
    for again in (Raster.over(raster.box, shape), Raster.centered(raster.box, step, shape)):
        np.testing.assert_allclose(again.origin, raster.origin, atol=1e-3)
        assert again.step == pytest.approx(step, rel=1e-3)


def test_a_cell_is_inside_as_long_as_its_centre_is_on_a_pixel() -> None:
    raster = raster_at((-2, -3), 2.0, (3, 4))
    x, y = raster.centers()
    assert x.tolist() == [-1.5, 0.5, 2.5, 4.5]
    assert y.tolist() == [-2.5, -0.5, 1.5]
    nothing, some = [False] * 4, [False, True, True, False]
    np.testing.assert_array_equal(raster.inside((4, 4)), [nothing, some, some])


def test_values_are_read_bilinearly_and_fade_to_nothing_a_cell_beyond_the_raster() -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4) + 1
    raster = raster_at((10, 20), 2.0, (3, 4))
    x, y = (axis.astype(np.float32) for axis in raster.centers())
    np.testing.assert_allclose(raster.read(values, x, y), values, atol=1e-5)
    between = raster.read(values, (x[:-1] + x[1:]) / 2, y)
    np.testing.assert_allclose(between, (values[:, :-1] + values[:, 1:]) / 2, atol=1e-5)
    np.testing.assert_allclose(raster.read(values, x[-1:] + 1.0, y)[:, 0], values[:, -1] / 2, atol=1e-5)
    assert not raster.read(values, np.array([x[-1] + 2.0, 900.0], np.float32), y).any()


def test_a_crop_sees_the_same_cells_from_its_own_corner() -> None:
    raster, corner = raster_at((10, 20), 2.5, (3, 4)), np.array([7, 9], np.float32)
    points = np.random.default_rng(0).uniform(0, 40, (20, 2)).astype(np.float32)
    np.testing.assert_allclose(raster.crop(corner).to_cells(points - corner), raster.to_cells(points), atol=1e-4)


@given(st.floats(0.1, 8), st.integers(0, 999))
def test_there_and_back_between_a_picture_and_its_copy(ratio: float, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-50, 500, (30, 2))
    np.testing.assert_allclose(scaled(scaled(points, ratio), 1 / ratio), points, atol=1e-6)


def test_two_pixels_of_a_row_become_one_of_half_the_size_between_them() -> None:
    np.testing.assert_allclose(scaled(np.array([[0.0, 0.0], [1.0, 1.0]]), 0.5), [[-0.25, -0.25], [0.25, 0.25]])
    np.testing.assert_allclose(sites(3, 0.5), [0.5, 2.5, 4.5])
    np.testing.assert_allclose(sites(4, 2.0), [-0.25, 0.25, 0.75, 1.25])


@given(st.floats(0.2, 5), st.floats(0.2, 5), st.integers(0, 999))
def test_a_map_to_a_scaled_copy_is_the_map_and_then_the_scaling(x: float, y: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, points, ratio = rng.normal(0, 2, (2, 3)), rng.uniform(0, 100, (10, 2)), np.array([x, y])
    there = points @ matrix[:, :2].T + matrix[:, 2]
    to_copy = scaled_affine(matrix, ratio)
    np.testing.assert_allclose(points @ to_copy[:, :2].T + to_copy[:, 2], scaled(there, ratio), atol=1e-6)


def test_readings_edges_and_unit_centres_agree_about_the_half_pixel() -> None:
    assert first_reading(10.0, 1.0) == 10.0
    assert first_reading(10.0, 3.0) == 11.0
    np.testing.assert_array_equal(from_edge(np.array([0.5, 3.0], np.float32)), [0.0, 2.5])
    np.testing.assert_allclose(from_edge(8 * centers_in_unit(8)), np.arange(8))


def test_kernels_are_told_what_arrays_are() -> None:
    raster, point = raster_at((-7.0, 12.0), 3.7, (9, 5)), np.array([20.25, 31.5])
    (x, y), ((column, row),) = raster.centers(), raster.to_cells(point[None])
    for at, corner, centers, cell in zip(point, raster.origin, (x, y), (column, row), strict=True):
        assert [cell_center(corner, raster.step, k) for k in range(len(centers))] == centers.tolist()
        assert cell_middle(corner, raster.step, 2) == to_edge(centers)[2]
        assert np.float32(cell_at(corner, raster.step, at)) == cell
    assert [on_copy(at, 0.5) for at in point] == scaled(point, 0.5).tolist()


def test_from_edge_undoes_to_edge() -> None:
    positions = np.array([-0.5, 0.0, 7.25])
    np.testing.assert_array_equal(to_edge(positions), [0.0, 0.5, 7.75])
    np.testing.assert_array_equal(from_edge(to_edge(positions)), positions)


def test_a_kernel_reaches_as_far_to_each_side_or_has_so_many_cells() -> None:
    assert square(2.4).shape == block(5).shape == (5, 5)
    assert square(0).shape == (3, 3)
    assert block(2).shape == (2, 2)
