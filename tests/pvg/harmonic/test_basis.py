"""Harmonic B-splines: the closed forms of eq. (2) and what the space reproduces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from pvg.harmonic.basis import HarmonicBasis, _source_potential, harmonic_basis, laplacian_matrix
from pvg.harmonic.quadtree import Quadtree, build_quadtree
from tests.pvg.harmonic.shapes import disc, ellipse

DOMAIN = disc(201, 80)
CURVES = np.concatenate([ellipse(100, 100, 79, 79), ellipse(80, 90, 12, 5), ellipse(100, 130, 20, 8)])


def source_potential(points: np.ndarray, side: float) -> np.ndarray:
    """Γ at each of (n, 2) points."""
    return np.array([_source_potential(x, y, side) for x, y in points.astype(float)])


@pytest.fixture(scope="module")
def graded() -> Quadtree:
    return build_quadtree(CURVES, DOMAIN, h_min=2.5, h_max=20.0)


@pytest.fixture(scope="module")
def uniform() -> HarmonicBasis:
    return harmonic_basis(build_quadtree(np.array([[100.0, 100.0]]), DOMAIN, h_min=5.0, h_max=5.0))


@pytest.fixture(scope="module")
def pixels() -> np.ndarray:
    y, x = np.nonzero(DOMAIN)
    return np.stack([x, y], axis=1)[::7].astype(float)


def test_source_at_its_own_centre_has_the_closed_value() -> None:
    assert source_potential(np.zeros((1, 2)), 1.0)[0] == pytest.approx(-0.168891, abs=1e-6)


@pytest.mark.parametrize("place", [(0.3, 0.2), (0.5, 0.5), (0.5, 0.1), (1.0, 0.0), (1.99, 0.1), (2.01, 0.1), (3, 4)])
def test_source_agrees_with_numerical_integration(place: tuple[float, float]) -> None:
    def integrand(v: float, u: float) -> float:
        distance = np.hypot(place[0] - u, place[1] - v)
        return float(np.log(max(distance, 1e-300)) / (2 * np.pi))

    # split at the place itself, where the integrand has its pole
    cut_x, cut_y = np.clip(place[0], -0.5, 0.5), np.clip(place[1], -0.5, 0.5)
    expected = sum(
        dblquad(integrand, x0, x1, y0, y1, epsabs=1e-10)[0]
        for x0, x1 in ((-0.5, cut_x), (cut_x, 0.5))
        for y0, y1 in ((-0.5, cut_y), (cut_y, 0.5))
        if x1 > x0 and y1 > y0
    )
    assert source_potential(np.array([place]), 1.0)[0] == pytest.approx(expected, abs=2e-8)


def test_source_is_smooth_where_the_series_takes_over() -> None:
    angle = np.linspace(0, 2 * np.pi, 50)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inside, outside = source_potential(2 * (1 - 1e-10) * ring, 1.0), source_potential(2 * (1 + 1e-10) * ring, 1.0)
    assert np.abs(inside - outside).max() < 1e-8


def test_scaling_a_source_adds_a_constant() -> None:
    points = np.random.default_rng(0).normal(size=(40, 2)) * 3
    scaled = source_potential(points * 7.0, 7.0)
    np.testing.assert_allclose(scaled, source_potential(points, 1.0) + np.log(7.0) / (2 * np.pi), atol=1e-12)


def test_uniform_function_has_the_known_values(uniform: HarmonicBasis) -> None:
    tree = uniform.tree
    middle = int(np.argmin(np.linalg.norm(tree.centers[: uniform.n_basis] - 100, axis=1)))
    steps = np.array([0.0, 1.0, 2.0, 2.9999999])
    points = tree.centers[middle] + np.stack([steps, 0 * steps], axis=1) * 5.0
    column = uniform.values(points).toarray()[:, middle]
    assert (np.abs(column - [0.678, 0.049, -0.0098, -0.0020]) < [5e-4, 5e-4, 5e-5, 5e-5]).all()


def test_functions_nearly_add_up_to_one(uniform: HarmonicBasis, graded: Quadtree, pixels: np.ndarray) -> None:
    even = np.asarray(uniform.values(pixels).sum(axis=1)) - 1
    assert np.abs(even).max() < 0.0086  # four functions at exactly 3h drop out together
    assert np.sqrt((even**2).mean()) < 0.0032
    uneven = np.asarray(harmonic_basis(graded).values(pixels).sum(axis=1)) - 1
    assert np.abs(uneven).max() < 0.075
    assert np.sqrt((uneven**2).mean()) < 0.018


def test_untruncated_functions_add_up_to_one_within_the_stated_figure() -> None:
    tree = build_quadtree(np.array([[60.0, 60.0]]), disc(121, 45), h_min=4.0, h_max=4.0)
    count = tree.n_basis
    weights = np.zeros((len(tree.sizes), len(tree.sizes)))
    i, j = tree.pairs.T
    weights[i, j] = weights[j, i] = tree.lengths / tree.distances
    weights -= np.diag(weights.sum(axis=1))
    y, x = np.nonzero(disc(121, 45))
    points = np.stack([x, y], axis=1)[::23].astype(float)
    sources = np.stack([source_potential(points - center, 4.0) for center in tree.centers], axis=1)
    total = (sources @ weights)[:, :count].sum(axis=1)
    assert np.abs(total - 1).max() < 0.0023


def test_rows_of_the_design_matrix_sum_to_one(graded: Quadtree, pixels: np.ndarray) -> None:
    matrix = harmonic_basis(graded).design_matrix(pixels)
    assert matrix.shape == (len(pixels), graded.n_basis)
    np.testing.assert_allclose(np.asarray(matrix.sum(axis=1)), 1.0, atol=1e-12)
    assert 20 < matrix.nnz / len(pixels) < 40


def test_linear_values_as_coefficients_are_reproduced(
    uniform: HarmonicBasis, graded: Quadtree, pixels: np.ndarray
) -> None:
    for basis, worst in ((uniform, 0.05), (harmonic_basis(graded), 0.45)):
        centers = basis.tree.centers[: basis.n_basis]
        error = np.abs(basis.design_matrix(pixels) @ centers - pixels)
        side = basis.tree.sizes[basis.tree.locate(pixels)]
        assert (error / side[:, None]).max() < worst


def test_linear_functions_are_reproduced_by_least_squares(graded: Quadtree, pixels: np.ndarray) -> None:
    basis = harmonic_basis(graded)
    matrix = basis.design_matrix(pixels)
    roughness = laplacian_matrix(graded)
    normal = matrix.T @ matrix + 1e-4 * roughness.T @ roughness
    coefficients = np.linalg.solve(normal.toarray() + 1e-9 * np.eye(graded.n_basis), matrix.T @ pixels)
    y, x = np.nonzero(DOMAIN)
    unseen = np.stack([x, y], axis=1)[3::7].astype(float)
    error = basis.design_matrix(unseen) @ coefficients - unseen
    # pixels, over a domain 160 pixels wide
    assert np.abs(error).max() < 0.9
    assert np.sqrt((error**2).mean()) < 0.12


def test_laplacian_is_symmetric_with_zero_row_sums(graded: Quadtree) -> None:
    matrix = laplacian_matrix(graded)
    assert matrix.shape == (graded.n_basis, graded.n_basis)
    assert abs(matrix - matrix.T).max() < 1e-12
    assert np.abs(np.asarray(matrix.sum(axis=1))).max() < 1e-12
    off_diagonal = matrix.toarray()[~np.eye(graded.n_basis, dtype=bool)]
    assert off_diagonal.min() >= 0.0


def test_laplacian_of_a_linear_function_vanishes_away_from_the_rim(graded: Quadtree) -> None:
    flow = laplacian_matrix(graded) @ graded.centers[: graded.n_basis]
    inner = graded.rings[: graded.n_basis] < 2
    assert np.abs(flow[inner]).max() < 1e-9


def test_points_far_from_the_domain_are_refused(graded: Quadtree) -> None:
    basis = harmonic_basis(graded)
    with pytest.raises(ValueError, match=r"\(900\.0, 3\.0\) lies outside"):
        basis.design_matrix(np.array([[100.0, 100.0], [900.0, 3.0]]))
    with pytest.raises(ValueError, match="finite"):
        basis.design_matrix(np.array([[np.nan, 1.0]]))
    assert basis.design_matrix(np.zeros((0, 2))).shape == (0, graded.n_basis)
