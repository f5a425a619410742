"""The least squares of eq. (3): normal equations, their preconditioner, and conjugate gradients on all channels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from pvg._arrays import Doubles
from pvg._threads import side_by_side
from pvg.errors import SolverError

RIDGE = 1e-9
"""ε of eq. (3). [derived: far below μ, yet a leaf that no pixel reaches has a value]"""

# Conjugate gradients; tolerances are residuals relative to the right-hand side.
_TOLERANCE = 1e-5  # [measured: g is off by at most 0.02 of a level]
_ROUGH_TOLERANCE = 1e-3  # where the solution only says which pixels to trust [measured: g moves by at most 0.5 level]
_MAX_ITERATIONS = 200  # [measured: portraits take 15 in all]
_WEAK_COUPLING = 1e-3
"""Entries below this part of the geometric mean of two diagonal ones are left out of the preconditioner. [measured: as
many iterations, and half the time of the factors]"""

# Huber's loss by repeated weighting
_REWEIGHTINGS = 2  # [by eye]
_HUBER_MEDIANS = 3.0  # median errors from which on a pixel is an outlier [by eye]
_HUBER_LEAST = 2.0  # levels that are never an outlier's error [by eye]


@dataclass(frozen=True)
class _NormalEquations:
    """A = BᵀWB + μ ΛᵀΛ + ε I of eq. (3), with pixel weights W; applied without being formed.

    Symmetric positive definite; Λ is symmetric.
    """

    B: sparse.csr_array
    roughness: sparse.csr_array  # Λ
    stiffness: float  # μ
    trust: Doubles  # the diagonal of W

    def __matmul__(self, columns: Doubles) -> Doubles:
        damped = self.stiffness * (self.roughness @ (self.roughness @ columns)) + RIDGE * columns
        return np.asarray(self.project(self.B @ columns) + damped)  # eq. (3), left-hand side

    def project(self, target: Doubles) -> Doubles:
        """BᵀW times (n, 3) values at the pixels: the right-hand side of eq. (3)."""
        return np.asarray(self.B.T @ (self.trust[:, None] * target))

    def matrix(self) -> sparse.csr_array:
        """A itself, (n, n): the product of the stacked roots (√W B, √μ Λ, √ε I)."""
        weighted = self.B.copy()
        weighted.data *= np.repeat(np.sqrt(self.trust), np.diff(self.B.indptr))
        ridge = np.sqrt(RIDGE) * sparse.eye_array(self.B.shape[1], format="csr")
        root = sparse.vstack([weighted, np.sqrt(self.stiffness) * self.roughness, ridge], format="csr")
        rows, half = sparse.csr_array(root.T), root.shape[1] // 2
        halves = side_by_side(lambda: rows[:half] @ root, lambda: rows[half:] @ root)
        return sparse.csr_array(sparse.vstack(halves, format="csr"))


def solve_least_squares(
    B: sparse.csr_array, roughness: sparse.csr_array, target: Doubles, trust: Doubles, smoothness: float
) -> Doubles:
    """Minimise the weighted, smoothed squares of eq. (3), by Huber's loss: what is not explained loses weight.

    The weights are found in rounds. The equations of later weights are close to the first ones, whose factors therefore
    precondition them.

    Args:
        B: (m, n), the functions at the pixels.
        roughness: (n, n) symmetric, Λ.
        target: (m, C), what the functions are to add up to at the pixels.
        trust: (m,) weights of the pixels, at most 1.
        smoothness: μ in units of mean diag(BᵀWB).

    Returns:
        (n, C) float64, the coefficients λ of eq. (2).

    Raises:
        SolverError: the equations are singular or miss their tolerance.
    """
    count = B.shape[1]
    mean_diagonal = float(((B.data**2) * np.repeat(trust, np.diff(B.indptr))).sum()) / count
    A = _NormalEquations(B, roughness, smoothness * mean_diagonal, trust)
    factors = _preconditioner(A.matrix())
    tolerances = [_ROUGH_TOLERANCE] * _REWEIGHTINGS + [_TOLERANCE]
    x = _conjugate_gradients(A, target, factors, np.zeros((count, target.shape[1])), tolerances[0])
    for tolerance in tolerances[1:]:
        error = np.linalg.norm(target - B @ x, axis=1)
        limit = max(_HUBER_MEDIANS * float(np.median(error)), _HUBER_LEAST)
        weights = trust * np.minimum(1.0, limit / np.maximum(error, limit))
        x = _conjugate_gradients(replace(A, trust=weights), target, factors, x, tolerance)
    return x


def _preconditioner(normal: sparse.csr_array) -> SuperLU:
    """Factors of the symmetric matrix without its weak couplings: nearly as good as all of it in half the time."""
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


def _conjugate_gradients(
    A: _NormalEquations, target: Doubles, factors: SuperLU, start: Doubles, tolerance: float
) -> Doubles:
    """Conjugate gradients on all channels at once, preconditioned by `factors`: one step when those are exact."""
    b = A.project(target)
    scale = np.maximum(np.linalg.norm(b, axis=0), 1e-12)
    x = start.copy()
    r = b - A @ x
    p = np.zeros_like(r)
    last_rz = np.ones(b.shape[1])
    for step in range(_MAX_ITERATIONS + 1):
        residual = float((np.linalg.norm(r, axis=0) / scale).max())
        if residual <= tolerance:
            return x
        if step == _MAX_ITERATIONS or not np.isfinite(residual):
            break
        z = factors.solve(r)
        rz = (r * z).sum(axis=0)
        beta = rz / last_rz if step else 0.0
        p = z + beta * p
        Ap = A @ p
        alpha = rz / np.maximum((p * Ap).sum(axis=0), 1e-300)  # a channel that is exact already stands still
        x += alpha * p
        r -= alpha * Ap
        last_rz = np.maximum(rz, 1e-300)
    raise SolverError(f"boundary colours: the normal equations were left with a relative residual of {residual:.1e}")
