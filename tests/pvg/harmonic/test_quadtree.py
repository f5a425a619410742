"""The quadtree tiles the domain, is balanced, and carries a Voronoi diagram."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.harmonic.quadtree import PADDING_RINGS, STENCIL_RING, Quadtree, build_quadtree
from tests.pvg.harmonic.shapes import disc, ellipse


def shared_sides(tree: Quadtree) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of leaves whose squares share a piece of side, by brute force."""
    gap = np.abs(tree.centers[:, None] - tree.centers[None])
    reach = 0.5 * (tree.sizes[:, None] + tree.sizes[None])
    slack = 1e-6 * tree.sizes.min()
    touch = np.abs(gap - reach[..., None]) < slack
    within = gap < reach[..., None] - slack
    sides = (touch[..., 0] & within[..., 1]) | (touch[..., 1] & within[..., 0])
    return np.nonzero(np.triu(sides))


@st.composite
def scenes(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, float, float]:
    size = draw(st.integers(20, 60))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    domain = disc(size, draw(st.floats(4.0, size / 2))) & (rng.random((size, size)) < draw(st.floats(0.3, 1.0)))
    domain[size // 2, size // 2] = True
    knots = rng.uniform(-3, size + 3, (draw(st.integers(1, 5)), 2))
    curves = np.concatenate([np.linspace(a, b, 80) for a, b in zip(knots, np.roll(knots, 1, axis=0), strict=True)])
    h_min = draw(st.floats(1.0, 4.0))
    return curves, domain, h_min, h_min * draw(st.floats(1.0, 17.0))


@settings(max_examples=40, deadline=None)
@given(scenes())
def test_leaves_are_balanced_disjoint_and_cover_the_domain(
    scene: tuple[np.ndarray, np.ndarray, float, float],
) -> None:
    curves, domain, h_min, h_max = scene
    tree = build_quadtree(curves, domain, h_min=h_min, h_max=h_max)
    i, j = shared_sides(tree)
    assert len(i) > 0
    ratio = tree.sizes[i] / tree.sizes[j]
    assert ((ratio > 0.49) & (ratio < 2.01)).all()
    exponents = np.log2(tree.sizes / h_min)
    np.testing.assert_allclose(exponents, np.rint(exponents), atol=1e-9)
    assert tree.sizes.max() <= h_max * (1 + 1e-9)

    gap = np.abs(tree.centers[:, None] - tree.centers[None]).max(axis=2)
    reach = 0.5 * (tree.sizes[:, None] + tree.sizes[None])
    np.fill_diagonal(gap, np.inf)
    assert (gap > reach - 1e-6).all()

    y, x = np.nonzero(domain)
    leaf = tree.locate(np.stack([x, y], axis=1))
    assert (leaf >= 0).all()
    assert (tree.rings[leaf] == 0).all()
    assert (np.abs(tree.centers[leaf] - np.stack([x, y], axis=1)).max(axis=1) <= tree.sizes[leaf] * 0.5 + 1e-6).all()


@settings(max_examples=40, deadline=None)
@given(scenes())
def test_a_leaf_is_fine_only_near_a_curve_or_for_balance(
    scene: tuple[np.ndarray, np.ndarray, float, float],
) -> None:
    curves, domain, h_min, h_max = scene
    tree = build_quadtree(curves, domain, h_min=h_min, h_max=h_max)
    gap = np.maximum(np.abs(tree.centers[:, None] - curves[None]) - 0.5 * tree.sizes[:, None, None], 0.0)
    distance = np.linalg.norm(gap, axis=2).min(axis=1)
    coarse = tree.sizes > 1.5 * h_min
    assert (distance[coarse] > 0.5 * tree.sizes[coarse] - 1e-6).all()
    # far from every curve, balance cannot force a leaf smaller than the largest
    largest = h_min * 2.0 ** np.floor(np.log2(h_max / h_min) + 1e-9)
    assert tree.sizes[distance > 4.0 * largest] == pytest.approx(largest)


def test_every_stencil_of_the_basis_leaves_closes() -> None:
    # Voronoi edges around a centre: Σ ℓ_ij n_ij = 0, so that the stencil has no dipole moment
    tree = build_quadtree(ellipse(60, 60, 40, 50), disc(121, 55), h_min=2.0, h_max=16.0)
    weights = tree.lengths / tree.distances
    i, j = tree.pairs.T
    moment = np.zeros_like(tree.centers)
    flow = weights[:, None] * (tree.centers[j] - tree.centers[i])
    np.add.at(moment, i, flow)
    np.add.at(moment, j, -flow)
    basis = tree.rings <= PADDING_RINGS
    assert basis.sum() == tree.n_basis
    assert np.abs(moment[basis]).max() < 1e-9
    assert np.abs(moment[~basis]).max() > 0.1  # the outermost ring is open


def test_uniform_leaves_have_four_neighbours_of_unit_weight() -> None:
    tree = build_quadtree(np.array([[20.0, 20.0]]), disc(41, 15), h_min=3.0, h_max=3.0)
    np.testing.assert_allclose(tree.lengths, 3.0)
    np.testing.assert_allclose(tree.distances, 3.0)
    inner = tree.rings <= PADDING_RINGS
    degree = np.bincount(tree.pairs.ravel(), minlength=len(tree.sizes))
    assert (degree[inner] == 4).all()


def test_two_rings_carry_functions_and_a_third_completes_their_stencils() -> None:
    tree = build_quadtree(ellipse(30, 30, 20, 20), disc(61, 24), h_min=2.0, h_max=8.0)
    assert set(tree.rings.tolist()) == {0, 1, 2, STENCIL_RING}
    assert (np.diff((tree.rings > PADDING_RINGS).astype(int)) >= 0).all()
    assert (tree.pairs[:, 0] < tree.pairs[:, 1]).all()
    steps = np.abs(tree.rings[tree.pairs[:, 0]] - tree.rings[tree.pairs[:, 1]])
    assert steps.max() == 1


def test_a_cropped_mask_gives_the_same_tree_moved() -> None:
    curves, mask, shift = ellipse(30, 32, 20, 20), disc(61, 24), np.array([100.0, 50.0])
    whole = build_quadtree(curves, mask, h_min=2.0, h_max=8.0)
    moved = build_quadtree(curves + shift, mask, h_min=2.0, h_max=8.0, origin=(100.0, 50.0))
    np.testing.assert_allclose(moved.centers, whole.centers + shift, atol=1e-9)
    np.testing.assert_array_equal(moved.pairs, whole.pairs)
    assert whole.locate(np.array([[-500.0, 3.0], [30.0, 30.0]]))[0] == -1


@pytest.mark.parametrize(
    ("curves", "domain", "h_min", "h_max", "match"),
    [
        (np.zeros((0, 2)), disc(9, 3), 1.0, 2.0, "curve points"),
        (np.full((3, 2), np.nan), disc(9, 3), 1.0, 2.0, "finite"),
        (np.ones((3, 2)), np.zeros((9, 9), dtype=bool), 1.0, 2.0, "at least one pixel"),
        (np.ones((3, 2)), disc(9, 3).astype(np.uint8), 1.0, 2.0, "bool"),
        (np.ones((3, 2)), disc(9, 3), 0.0, 2.0, "h_min"),
        (np.ones((3, 2)), disc(9, 3), 3.0, 2.0, "h_min"),
        (np.ones((3, 2)), disc(999, 300), 0.01, 2.0, "too small"),
    ],
)
def test_bad_input_is_refused(curves: np.ndarray, domain: np.ndarray, h_min: float, h_max: float, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        build_quadtree(curves, domain, h_min=h_min, h_max=h_max)
