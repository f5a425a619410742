"""Boundary colours of the diffusion curves by least squares in the harmonic B-spline space (eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.ndimage import binary_erosion
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial import KDTree

from pvg._threads import side_by_side
from pvg.errors import SolverError
from pvg.harmonic.basis import HarmonicBasis, harmonic_basis, laplacian_matrix
from pvg.harmonic.quadtree import Bools, Floats, Quadtree, build_quadtree

SMOOTHNESS = 1e-2  # μ in units of mean diag(BᵀB); predicts held-out pixels at the curves of portraits best
RIDGE = 1e-9  # ε
LEVELS_OF_REFINEMENT = 8.0  # default h_max / h_min

_TOLERANCE = 1e-5  # relative residual of the normal equations: at most 0.02 of a level
_ROUGH_TOLERANCE = 1e-3  # where the solution only says which pixels to trust
_REWEIGHTINGS = 2
_MAX_ITERATIONS = 200
_WEAK_COUPLING = 1e-3  # of the geometric mean of two diagonal entries: left out of the preconditioner
_LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class BoundaryFit:
    """A smooth colour field u on the domain and its trace g on the curves.

    Attributes:
        colors: (S, 3) float32, 0–255 RGB: g = u|γ, one colour a curve point.
        coefficients: (n_leaves, 3) float64, λ of u = Σ λ_i ψ_i.
        residual: root mean square of image − u over the sampled pixels and channels, in levels of 255.
        basis: the functions ψ_i, for `evaluate`.
    """

    colors: npt.NDArray[np.float32]
    coefficients: Floats
    residual: float
    basis: HarmonicBasis

    @property
    def n_leaves(self) -> int:
        """Number of basis functions."""
        return self.basis.n_leaves


@dataclass(frozen=True)
class _Sample:
    """Pixels of the domain: (n, 2) places in pixels, (n, 3) colours 0–255, (n,) trust."""

    points: Floats
    colors: Floats
    trust: Floats


def fit_boundary_colors(
    image: npt.NDArray[Any],
    domain: npt.NDArray[np.bool_],
    curve_points: npt.NDArray[Any],
    *,
    h_min: float,
    h_max: float | None = None,
    samples: int = 16_000,
    rng: np.random.Generator,
    weights: npt.NDArray[Any] | None = None,
    sample_inset: npt.NDArray[Any] | None = None,
    smoothness: float = SMOOTHNESS,
    robust: bool = True,
) -> BoundaryFit:
    """Fit u = Σ λ_i ψ_i to the image on Ω and read it on the curves: g = u|γ (eq. 3).

    Solves (BᵀWB + μ ΛᵀΛ + ε I) λ = BᵀW I for the three channels. Points of γ more than a pixel outside Ω are read
    at the nearest pixel of Ω, where the field is supported by data.

    Args:
        image: (H, W, 3) uint8 or float, RGB 0–255.
        domain: (H, W) bool, the pixels of Ω.
        curve_points: (S, 2) float, (x, y) in pixels; the quadtree is refined at them.
        h_min: side of the smallest leaf in pixels; about a hundredth of the face's width.
        h_max: side of the largest leaf in pixels; 8 h_min when None.
        samples: number of pixels of Ω used; all of them if there are fewer.
        rng: draws the pixels.
        weights: (H, W) float >= 0, trust in each pixel, 0 = unknown (hidden, not skin); all 1 when None.
        sample_inset: (S, 2) float, where g is read instead of at `curve_points`, e.g. a little inside the mask.
        smoothness: μ in units of mean diag(BᵀB), > 0.
        robust: down-weight specular highlights and pixels that the smooth field cannot explain.

    Raises:
        ValueError: an empty domain, no curve points, shapes that disagree, or no trusted pixel.
        SolverError: the normal equations are singular or miss their tolerance.
    """
    h_max = LEVELS_OF_REFINEMENT * h_min if h_max is None else h_max
    _check_inputs(image, domain, curve_points, weights, sample_inset, samples, smoothness)
    tree = _tree_of(domain, curve_points, h_min, h_max)
    basis = harmonic_basis(tree)
    sample = _draw(image, domain, weights, tree, samples, rng)
    B = basis.design_matrix(sample.points)
    roughness = laplacian_matrix(tree)
    trust = sample.trust
    if robust:
        trust = trust * _highlight_weights(sample, 2.0 * h_max)
    base = np.average(sample.colors, axis=0, weights=trust)
    # λ is sought around the mean colour: constants are exact and ε pulls to skin, not to black
    shifts = _solve(B, roughness, sample.colors - base, trust, smoothness, reweight=robust)
    error = sample.colors - base - B @ shifts
    residual = float(np.sqrt(np.average((error**2).mean(axis=1), weights=sample.trust)))
    places = _move_inside(curve_points if sample_inset is None else sample_inset, domain)
    colors = np.clip(base + basis.design_matrix(places) @ shifts, 0.0, 255.0).astype(np.float32)
    return BoundaryFit(colors, base + shifts, residual, basis)


def evaluate(fit: BoundaryFit, points: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """The fitted smooth field u at (n, 2) points (x, y) in pixels: (n, 3) float32, RGB, not clipped.

    Raises:
        ValueError: a point lies outside the domain of the fit.
    """
    return np.asarray(fit.basis.design_matrix(points) @ fit.coefficients).astype(np.float32)


def _check_inputs(
    image: npt.NDArray[Any],
    domain: npt.NDArray[Any],
    curve_points: npt.NDArray[Any],
    weights: npt.NDArray[Any] | None,
    sample_inset: npt.NDArray[Any] | None,
    samples: int,
    smoothness: float,
) -> None:
    if image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"the image must have shape (H, W, 3); got {image.shape}")
    if domain.shape != image.shape[:2] or domain.dtype != np.bool_:
        raise ValueError(f"the domain must be bool of shape {image.shape[:2]}; got {domain.dtype} {domain.shape}")
    if not domain.any():
        raise ValueError("the domain is empty: no pixel to fit colours to")
    if not 0.0 < smoothness < np.inf:
        raise ValueError(f"smoothness must be positive; got {smoothness}")
    if samples < 1:
        raise ValueError(f"samples must be at least 1; got {samples}")
    if sample_inset is not None and (
        np.shape(sample_inset) != np.shape(curve_points) or not np.isfinite(sample_inset).all()
    ):
        raise ValueError("sample_inset must be finite and have one point for each curve point")
    if weights is not None and weights.shape != domain.shape:
        raise ValueError(f"weights must have shape {domain.shape}; got {weights.shape}")
    if weights is not None and not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise ValueError("weights must be finite and not negative")


def _tree_of(domain: Bools, curve_points: npt.NDArray[Any], h_min: float, h_max: float) -> Quadtree:
    """The quadtree over the bounding box of the domain, in the image's own coordinates."""
    rows, columns = np.flatnonzero(domain.any(axis=1)), np.flatnonzero(domain.any(axis=0))
    crop = domain[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    origin = (float(columns[0]), float(rows[0]))
    return build_quadtree(curve_points, crop, h_min=h_min, h_max=h_max, origin=origin)


def _draw(
    image: npt.NDArray[Any],
    domain: Bools,
    weights: npt.NDArray[Any] | None,
    tree: Quadtree,
    samples: int,
    rng: np.random.Generator,
) -> _Sample:
    """Pixels drawn without repetition from the trusted part of the domain, every leaf alike.

    An even draw over the pixels would leave most of the fine leaves at the curves, where g is read, without data.
    """
    trusted = np.flatnonzero(domain if weights is None else domain & (weights > 0))
    if not len(trusted):
        raise ValueError("no pixel of the domain has a positive weight")
    y, x = np.divmod(trusted, domain.shape[1])
    if len(trusted) > samples:
        side = tree.sizes[tree.locate(np.stack([x, y], axis=1))]
        # the smallest of exponentials with rates 1 / h² are a weighted draw without replacement
        chosen = np.argpartition(rng.standard_exponential(len(trusted)) * side**2, samples)[:samples]
        y, x = y[chosen], x[chosen]
    colors = image[y, x].astype(np.float64)
    if not np.isfinite(colors).all():
        raise ValueError("the image has non-finite values inside the domain")
    trust = np.ones(len(x)) if weights is None else weights[y, x].astype(np.float64)
    return _Sample(np.stack([x, y], axis=1).astype(np.float64), colors, trust / trust.max())


def _highlight_weights(sample: _Sample, side: float) -> Floats:
    """Near 0 on specular highlights: brighter than their surroundings by far, and paler or clipped.

    A highlight adds the colour of the light to that of the skin, so it loses saturation; skin that is merely better
    lit keeps it. Leaves at the curves are finer than a highlight, so the fit's own residual cannot show it: brightness
    is compared with the median of square cells of the given side instead.
    """
    top, low = sample.colors.max(axis=1), sample.colors.min(axis=1)
    luma = sample.colors @ _LUMA
    saturation = (top - low) / np.maximum(top, 1.0)
    cells = np.floor(sample.points / side).astype(np.int64)
    _, cell = np.unique(cells @ (1 << 20, 1), return_inverse=True)
    order = np.lexsort((luma, cell))
    counts = np.bincount(cell)
    starts = np.cumsum(counts) - counts

    def quantile(values: Floats, ranking: npt.NDArray[Any], share: float) -> Floats:
        picked: Floats = values[ranking[starts + (share * (counts - 1)).astype(np.int64)]]
        return picked

    middle = quantile(luma, order, 0.5)
    spread = (quantile(luma, order, 0.75) - quantile(luma, order, 0.25)) / 1.349
    typical = quantile(saturation, np.lexsort((saturation, cell)), 0.5)
    excess = (luma - middle[cell]) / np.maximum(spread, 4.0)[cell]
    pale = (saturation < 0.75 * typical[cell]) | (low >= 250.0)
    suspicious = np.where(pale, np.clip((excess - 2.0) / 1.5, 0.0, 1.0), 0.0)
    return np.maximum(1.0 - suspicious, 1e-3)  # never 0: a face that is all highlight still has a colour


@dataclass(frozen=True)
class _NormalEquations:
    """A = BᵀWB + μ ΛᵀΛ + ε I of eq. (3), with pixel weights W; applied without being formed."""

    B: sparse.csr_array
    roughness: sparse.csr_array
    stiffness: float  # μ
    trust: Floats

    def __matmul__(self, columns: Floats) -> Floats:
        damped = self.stiffness * (self.roughness @ (self.roughness @ columns)) + RIDGE * columns  # Λ is symmetric
        return np.asarray(self.project(self.B @ columns) + damped)

    def project(self, target: Floats) -> Floats:
        """BᵀW times (n, 3) values at the pixels."""
        return np.asarray(self.B.T @ (self.trust[:, None] * target))

    def matrix(self) -> sparse.csr_array:
        """A itself, (n, n)."""
        weighted = self.B.copy()
        weighted.data *= np.repeat(np.sqrt(self.trust), np.diff(self.B.indptr))
        ridge = np.sqrt(RIDGE) * sparse.eye_array(self.B.shape[1], format="csr")
        root = sparse.vstack([weighted, np.sqrt(self.stiffness) * self.roughness, ridge], format="csr")
        rows, half = sparse.csr_array(root.T), root.shape[1] // 2
        halves = side_by_side(lambda: rows[:half] @ root, lambda: rows[half:] @ root)
        return sparse.csr_array(sparse.vstack(halves, format="csr"))


def _solve(
    B: sparse.csr_array,
    roughness: sparse.csr_array,
    target: Floats,
    trust: Floats,
    smoothness: float,
    *,
    reweight: bool,
) -> Floats:
    """Minimise the weighted, smoothed squares (eq. 3); with `reweight`, Huber's loss by repeated weighting.

    The equations of later weights are close to the first ones, whose factors therefore precondition them.
    """
    count = B.shape[1]
    mean_diagonal = float(((B.data**2) * np.repeat(trust, np.diff(B.indptr))).sum()) / count
    equations = _NormalEquations(B, roughness, smoothness * mean_diagonal, trust)
    factors = _factorise(equations.matrix())
    rounds = _REWEIGHTINGS if reweight else 0
    tolerances = [_ROUGH_TOLERANCE] * rounds + [_TOLERANCE]
    shifts = _refine_solution(equations, target, factors, np.zeros((count, target.shape[1])), tolerances[0])
    for tolerance in tolerances[1:]:
        error = np.linalg.norm(target - B @ shifts, axis=1)
        limit = max(3.0 * float(np.median(error)), 2.0)
        weights = trust * np.minimum(1.0, limit / np.maximum(error, limit))
        shifts = _refine_solution(replace(equations, trust=weights), target, factors, shifts, tolerance)
    return shifts


def _factorise(normal: sparse.csr_array) -> SuperLU:
    """Factors of the symmetric matrix without its weak couplings: nearly as good a preconditioner in half the time."""
    rows = np.repeat(np.arange(normal.shape[0]), np.diff(normal.indptr))
    root = np.sqrt(normal.diagonal())
    strong = normal.copy()
    strong.data[np.abs(normal.data) <= _WEAK_COUPLING * root[rows] * root[normal.indices]] = 0.0
    strong.eliminate_zeros()
    by_columns = strong.T  # its rows are its columns
    try:
        return splu(by_columns, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:  # SuperLU's word for an exactly singular factor
        raise SolverError(f"boundary colours: the normal equations are singular ({error})") from error


def _refine_solution(
    normal: _NormalEquations, target: Floats, factors: SuperLU, start: Floats, tolerance: float
) -> Floats:
    """Conjugate gradients on all channels at once, preconditioned by `factors`: one step when those are exact."""
    right = normal.project(target)
    scale = np.maximum(np.linalg.norm(right, axis=0), 1e-12)
    solution = start.copy()
    rest = right - normal @ solution
    direction = np.zeros_like(rest)
    before = np.ones(right.shape[1])
    for step in range(_MAX_ITERATIONS + 1):
        miss = float((np.linalg.norm(rest, axis=0) / scale).max())
        if miss <= tolerance:
            return solution
        if step == _MAX_ITERATIONS or not np.isfinite(miss):
            break
        shaped = factors.solve(rest)
        now = (rest * shaped).sum(axis=0)
        direction = shaped + (now / before if step else 0.0) * direction
        image = normal @ direction
        length = np.maximum((direction * image).sum(axis=0), 1e-300)  # a channel that is exact already stands still
        solution += now / length * direction
        rest -= now / length * image
        before = np.maximum(now, 1e-300)
    raise SolverError(f"boundary colours: the normal equations were left with a relative residual of {miss:.1e}")


def _move_inside(places: npt.NDArray[Any], domain: Bools) -> Floats:
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
