"""The operator of eq. (1): what a solve gives, how near to the direct solution, in how many cycles."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.direct import direct_membrane, held_pixels
from pvg.errors import SolverError
from pvg.membrane import TOLERANCE, Lattice, MembraneOperator, build_membrane, cut_edges
from pvg.membrane import operator as operator_module
from tests.pvg.membrane.scenes import (
    FACE_HEIGHT,
    FACE_WIDTH,
    Layout,
    direct_on_lattice,
    face_operator,
    random_curves,
    synthetic_face,
    values_at,
)

generators = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@pytest.fixture(scope="module")
def face() -> tuple[MembraneOperator, np.ndarray]:
    return face_operator()


def test_the_synthetic_face_has_corrections_of_70_levels_and_600_samples() -> None:
    points, _, values = synthetic_face()
    assert np.abs(values).max() == pytest.approx(70.0)
    assert len(points) == len(values) == 589
    assert np.ptp(values) > 80


def test_a_quarter_size_membrane_matches_the_direct_full_size_solve(
    face: tuple[MembraneOperator, np.ndarray],
) -> None:
    points, layout, values = synthetic_face()
    held, known = held_pixels(points, tuple(layout), values, (FACE_WIDTH, FACE_HEIGHT))
    assert 5_000 < known.sum() < 20_000
    y, x = np.mgrid[:FACE_HEIGHT, :FACE_WIDTH]
    # inside the boundary curve and a little beyond, where the matte lies
    domain = ((x / FACE_WIDTH - 0.5) / 0.45) ** 2 + ((y / FACE_HEIGHT - 0.52) / 0.45) ** 2 < 1.0
    inside = ((x / FACE_WIDTH - 0.5) / 0.44) ** 2 + ((y / FACE_HEIGHT - 0.52) / 0.44) ** 2 < 1.0
    reference = direct_membrane(held, known, domain)
    membrane = face[0].solve(values)
    assert 150 <= membrane.lattice.height <= 282
    error = np.abs(membrane.crop(0, 0, FACE_WIDTH, FACE_HEIGHT) - reference)[inside]
    assert error.mean() < 0.15
    assert np.percentile(error, 99) < 1.0


@pytest.mark.parametrize("tolerance", [1.0, TOLERANCE, 0.02, 0.001])
def test_the_error_stays_below_the_tolerance(face: tuple[MembraneOperator, np.ndarray], tolerance: float) -> None:
    operator, values = face
    exact = direct_on_lattice(operator, values)
    assert np.abs(operator.solve(values, tolerance=tolerance).planes - exact).max() < tolerance


def test_a_face_takes_three_cycles(face: tuple[MembraneOperator, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    operator, values = face
    monkeypatch.setattr(operator_module, "MAX_CYCLES", 3)
    operator.solve(values, tolerance=TOLERANCE)


def test_a_missed_tolerance_raises_with_the_error(
    face: tuple[MembraneOperator, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    operator, values = face
    monkeypatch.setattr(operator_module, "MAX_CYCLES", 2)
    with pytest.raises(SolverError, match=r"channel 0, is off by about [0-9.]+ levels after 2 cycles .wanted 0.01."):
        operator.solve(values, tolerance=0.01)
    with pytest.raises(SolverError, match="finer than float32"):
        operator.solve(values, tolerance=1e-6)


@given(generators, st.integers(4, 60), st.integers(4, 60))
@settings(max_examples=60, deadline=None)
def test_random_curves_give_the_direct_solution_within_the_range_of_their_values(
    rng: np.random.Generator, width: int, height: int
) -> None:
    points, layout, values = random_curves(rng, width, height)
    operator = build_membrane(cut_edges(points, layout, Lattice.over((0, 0, width, height))))
    planes = operator.solve(values, tolerance=0.0025).planes
    assert np.abs(planes - direct_on_lattice(operator, values)).max() < 0.01
    assert (planes >= values.min(axis=0)[:, None, None] - 0.01).all()
    assert (planes <= values.max(axis=0)[:, None, None] + 0.01).all()


@pytest.mark.parametrize(("width", "height"), [(300, 4), (4, 300), (300, 9), (7, 250), (2, 90), (140, 3), (67, 5)])
def test_thin_boxes_give_the_direct_solution(width: int, height: int) -> None:
    for seed in range(4):
        points, layout, values = random_curves(np.random.default_rng(seed), width, height)
        lattice = Lattice.over((0, 0, width, height), target_height=height)
        operator = build_membrane(cut_edges(points, layout, lattice))
        planes = operator.solve(values, tolerance=0.0025).planes
        assert np.abs(planes - direct_on_lattice(operator, values)).max() < 0.01


def test_a_thin_box_costs_no_more_than_its_length() -> None:
    def seconds(length: int) -> float:
        points, layout, values = random_curves(np.random.default_rng(0), length, 4)
        operator = build_membrane(cut_edges(points, layout, Lattice.over((0, 0, length, 4))))
        taken = []
        for _ in range(3):
            start = time.thread_time()
            operator.solve(values)
            taken.append(time.thread_time() - start)
        return min(taken)

    assert seconds(1200) < 3 * 8 * seconds(150)  # with its cube it would be 512


@pytest.mark.parametrize(
    ("layout", "active"), [([], None), ([(0, 2, False)], None), ([(2, 4, False)], [True, True, True, False])]
)
def test_curves_that_miss_the_lattice_are_an_error(layout: Layout, active: list[bool] | None) -> None:
    points = [[-50.0, -50.0], [-10.0, -60.0], [10.0, 10.3], [20.0, 15.0]]
    cuts = cut_edges(points, layout, Lattice.over((0, 0, 60, 40)), active=active)
    with pytest.raises(SolverError, match="no curve crosses"):
        build_membrane(cuts)


@given(generators, st.floats(-300.0, 300.0, width=32))
@settings(max_examples=20, deadline=None)
def test_constants_are_exact(rng: np.random.Generator, level: float) -> None:
    points, layout, values = random_curves(rng, 40, 30)
    operator = build_membrane(cut_edges(points, layout, Lattice.over((0, 0, 40, 30))))
    np.testing.assert_allclose(operator.solve(np.full_like(values, level)).planes, level, atol=1e-4)


def test_a_plane_on_the_border_is_a_plane_inside() -> None:
    corners = np.array([[3.3, 4.7], [90.1, 2.2], [96.6, 70.9], [8.4, 77.7]])
    values = (2.0 + 0.5 * corners[:, 0] - 0.25 * corners[:, 1])[:, None]
    operator = build_membrane(cut_edges(corners, [(0, 4, True)], Lattice.over((0, 0, 100, 80))))
    membrane = operator.solve(values, tolerance=1e-3)
    inner = np.random.default_rng(0).uniform((15, 12), (85, 65), (200, 2))
    read = values_at(membrane, inner)[:, 0]
    np.testing.assert_allclose(read, 2.0 + 0.5 * inner[:, 0] - 0.25 * inner[:, 1], atol=5e-3)


def test_the_solution_is_linear_in_the_values(face: tuple[MembraneOperator, np.ndarray]) -> None:
    operator, values = face
    other = np.roll(values, 31, axis=0)
    first, second = operator.solve(values, tolerance=2e-3), operator.solve(other, tolerance=2e-3)
    both = operator.solve(0.5 * values - 0.75 * other, tolerance=2e-3)
    np.testing.assert_allclose(both.planes, 0.5 * first.planes - 0.75 * second.planes, atol=6e-3)


def test_several_looks_share_one_operator(face: tuple[MembraneOperator, np.ndarray]) -> None:
    operator, values = face
    together = operator.solve(np.concatenate((values, -values), axis=1))
    np.testing.assert_array_equal(together.planes[:3], operator.solve(values).planes)
    np.testing.assert_allclose(together.planes[3:], -together.planes[:3], atol=1e-4)


@given(generators, st.integers(16, 70))
@settings(max_examples=40, deadline=None)
def test_a_closed_curve_shuts_its_inside_off(rng: np.random.Generator, size: int) -> None:
    count = int(rng.integers(3, 30))
    radius = rng.uniform(0.15, 0.35, count) * size
    angle = np.arange(count) / count * 2 * np.pi
    star = size / 2 + radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    star = np.where(rng.random(star.shape) < 0.3, np.rint(star), star)
    frame = np.array([[0.5, 0.5], [size - 1.5, 0.5], [size - 1.5, size - 1.5], [0.5, size - 1.5]])
    points, layout = np.concatenate((star, frame)), [(0, count, True), (count, count + 4, True)]
    values = np.where(np.arange(count + 4) < count, 0.0, 60.0)[:, None]
    plane = (
        build_membrane(cut_edges(points, layout, Lattice.over((0, 0, size, size))))
        .solve(values, tolerance=4e-4)
        .planes[0]
    )
    centre = round(size / 2)
    assert abs(plane[centre, centre]) < 0.01
    assert plane[0, 0] == pytest.approx(60.0, abs=0.01)


def test_values_of_the_wrong_shape_or_without_meaning_are_refused(face: tuple[MembraneOperator, np.ndarray]) -> None:
    operator, values = face
    with pytest.raises(ValueError, match="must have the shape"):
        operator.solve(values[:-1])
    with pytest.raises(SolverError, match="NaN"):
        operator.solve(np.full_like(values, np.nan))
