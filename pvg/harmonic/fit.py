"""Boundary colours g of the diffusion curves by least squares in the harmonic B-spline space (eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import KDTree

from pvg._arrays import Bools, Doubles, Floats
from pvg.harmonic.basis import HarmonicBasis, harmonic_basis, laplacian_matrix
from pvg.harmonic.normal_equations import solve_least_squares
from pvg.harmonic.quadtree import Quadtree, build_quadtree
from pvg.harmonic.sampling import draw_sample, highlight_trust

_SAMPLES = 16_000  # pixels that are fitted; all of them where there are fewer [by eye]
_SMOOTHNESS = 1e-2  # μ in units of mean diag(BᵀWB) [measured: docs/decisions/0052]
_LARGEST_LEAF = 8.0  # h_max / h_min [by eye]
_HIGHLIGHT_CELL = 2.0  # of the largest leaf's side: where highlights stand out [by eye]


@dataclass(frozen=True)
class BoundaryFit:
    """A smooth colour field u on the domain and its trace g on the curves.

    Attributes:
        colors: (S, 3) float32, 0–255 RGB: g = u|γ, one colour a curve point.
        coefficients: (n_basis, 3) float64, λ of u = Σ λ_i ψ_i.
        basis: the functions ψ_i.
    """

    colors: Floats
    coefficients: Doubles
    basis: HarmonicBasis


def fit_boundary_colors(
    image: NDArray[Any],
    domain: Bools,
    curve_points: NDArray[Any],
    *,
    h_min: float,
    rng: np.random.Generator,
) -> BoundaryFit:
    """Fit u = Σ λ_i ψ_i to the image on Ω and read it on the curves: g = u|γ (eq. 3).

    Solves (BᵀWB + μ ΛᵀΛ + ε I) λ = BᵀW I for the three channels. Specular highlights and pixels that the smooth field
    cannot explain have little weight. Points of γ more than a pixel outside Ω are read at the nearest pixel of Ω, where
    the field is supported by data.

    Args:
        image: (H, W, 3) uint8 or float, RGB 0–255.
        domain: (H, W) bool, the pixels of Ω.
        curve_points: (S, 2) float, (x, y) in pixels; the quadtree is refined at them.
        h_min: side of the smallest leaf in pixels; some hundredth of the face's width.
        rng: draws the pixels of Ω that are fitted.

    Raises:
        ValueError: an empty domain, no curve points, shapes that disagree, or pixels that are not finite.
        SolverError: the normal equations are singular or miss their tolerance.
    """
    _check_inputs(image, domain)
    h_max = _LARGEST_LEAF * h_min
    tree = _tree_of(domain, curve_points, h_min, h_max)
    basis = harmonic_basis(tree)
    sample = draw_sample(image, domain, tree, _SAMPLES, rng)
    B = basis.design_matrix(sample.points)
    trust = highlight_trust(sample, _HIGHLIGHT_CELL * h_max)
    base = np.average(sample.colors, axis=0, weights=trust)
    # λ is sought around the mean colour: constants are exact and ε pulls to skin, not to black
    shifts = solve_least_squares(B, laplacian_matrix(tree), sample.colors - base, trust, _SMOOTHNESS)  # eq. (3)
    places = _move_inside(curve_points, domain)
    colors = np.clip(base + basis.design_matrix(places) @ shifts, 0.0, 255.0).astype(np.float32)  # eq. (2): g = u|γ
    return BoundaryFit(colors, base + shifts, basis)


def _check_inputs(image: NDArray[Any], domain: NDArray[Any]) -> None:
    if image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"the image must have shape (H, W, 3); got {image.shape}")
    if domain.shape != image.shape[:2] or domain.dtype != np.bool_:
        raise ValueError(f"the domain must be bool of shape {image.shape[:2]}; got {domain.dtype} {domain.shape}")
    if not domain.any():
        raise ValueError("the domain is empty: no pixel to fit colours to")


def _tree_of(domain: Bools, curve_points: NDArray[Any], h_min: float, h_max: float) -> Quadtree:
    """The quadtree over the bounding box of the domain, in the image's own coordinates."""
    rows, columns = np.flatnonzero(domain.any(axis=1)), np.flatnonzero(domain.any(axis=0))
    crop = domain[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    origin = (float(columns[0]), float(rows[0]))
    return build_quadtree(curve_points, crop, h_min=h_min, h_max=h_max, origin=origin)


def _move_inside(places: NDArray[Any], domain: Bools) -> Doubles:
    """The same points, those more than a pixel outside the domain moved to its nearest pixel."""
    points = np.array(places, dtype=np.float64)
    height, width = domain.shape
    x, y = np.rint(points).astype(np.int64).T
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    inside[inside] = domain[y[inside], x[inside]]
    outside = np.flatnonzero(~inside)
    if len(outside):
        rim = np.argwhere(domain & ~binary_erosion(domain))[:, ::-1]
        distance, nearest = KDTree(rim).query(points[outside])
        far = np.asarray(distance) > 1.0
        points[outside[far]] = rim[np.asarray(nearest)[far]]
    return points
