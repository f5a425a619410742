"""The normal equations of eq. (3) and their preconditioned conjugate gradients."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from pvg.errors import SolverError
from pvg.harmonic import normal_equations
from pvg.harmonic.normal_equations import RIDGE, _NormalEquations, _preconditioner, solve_least_squares

CHAIN = sparse.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(30, 30), format="csr")  # type: ignore[call-overload]


def rows_of_three(rng: np.random.Generator) -> sparse.csr_array:
    """(200, 30), three random entries a row."""
    row, column = np.repeat(np.arange(200), 3), rng.integers(0, 30, 600)
    return sparse.csr_array(sparse.coo_array((rng.random(600), (row, column)), shape=(200, 30)))


def test_the_operator_is_its_matrix() -> None:
    rng = np.random.default_rng(0)
    A = _NormalEquations(rows_of_three(rng), CHAIN, 0.3, rng.random(200))
    columns = rng.normal(size=(30, 3))
    np.testing.assert_allclose(A @ columns, A.matrix() @ columns, rtol=1e-12, atol=1e-12)


def test_the_solution_is_that_of_dense_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(normal_equations, "_REWEIGHTINGS", 0)
    rng = np.random.default_rng(1)
    B, trust, target = rows_of_three(rng), rng.uniform(0.2, 1.0, 200), rng.normal(0.0, 30.0, (200, 3))
    found = solve_least_squares(B, CHAIN, target, trust, 0.5)
    weighted = B.toarray().T * trust
    mu = 0.5 * np.diag(weighted @ B.toarray()).mean()
    dense = weighted @ B.toarray() + mu * (CHAIN @ CHAIN).toarray() + RIDGE * np.eye(30)
    np.testing.assert_allclose(found, np.linalg.solve(dense, weighted @ target), atol=1e-2)


def test_a_singular_system_is_an_error() -> None:
    with pytest.raises(SolverError, match="singular"):
        _preconditioner(sparse.csr_array(np.diag([1.0, 0.0, 2.0])))
