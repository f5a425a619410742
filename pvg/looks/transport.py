"""Sliced optimal mass transport between two sets of colours (eq. 7 and 8).

Each step projects both sets on the axes of a random rotation, matches their one-dimensional quantiles and
moves the colours a fraction β towards the match. Colours have no order and no position here: the result for a
colour depends only on its value and on the two distributions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pvg._arrays import Doubles

BETA = 0.2  # β of eq. (7) [paper]
ITERATIONS = 20  # N of eq. (7) [paper]


def sliced_transport(
    colors: ArrayLike,
    reference: ArrayLike,
    *,
    rng: np.random.Generator,
    beta: float = BETA,
    iterations: int = ITERATIONS,
    weights: ArrayLike | None = None,
) -> Doubles:
    """Move `colors` to the distribution of `reference`: T ← T + β (M uᵀ − T), once a random rotation u.

    colors, reference: (n, 3) and (m, 3), finite, 0–255 RGB (any linear colour space works).
    weights: (n,) positive mass of each of `colors`; equal masses when None.
    Returns (n, 3) float64 in the order of `colors`; it is not clipped to the colour range.

    The result does not depend on the order of either set, equal colours stay equal bit for bit, and equal sets
    are a fixed point. With as many colours as reference colours of equal mass, the gap of the means after N
    iterations is (1 − β)^N of what it was. Raises ValueError on empty or non-finite input and on parameters out
    of range.
    """
    moved = _checked_colors(colors, "colors").copy()
    target = _checked_colors(reference, "reference")
    mass = _checked_weights(weights, len(moved))
    if not 0.0 < beta <= 1.0:
        raise ValueError(f"beta must lie in (0, 1], got {beta}")
    if iterations < 0:
        raise ValueError(f"iterations must not be negative, got {iterations}")
    for _ in range(iterations):
        u = _random_rotation(rng)
        matched = np.empty_like(moved)
        for axis in range(3):
            direction = u[:, axis]
            matched[:, axis] = _match(_project(moved, direction), mass, _project(target, direction))
        for channel in range(3):
            back = _project(matched, u[channel])
            moved[:, channel] += beta * (back - moved[:, channel])  # eq. (7)
    return moved


def sliced_wasserstein(a: ArrayLike, b: ArrayLike, *, rng: np.random.Generator, projections: int = 64) -> float:
    """Sliced 2-Wasserstein distance of two colour sets, in levels.

    The root of the mean, over `projections` random directions, of the squared exact one-dimensional distance.
    a, b: (n, 3) and (m, 3). Raises ValueError like `sliced_transport`.
    """
    first, second = _checked_colors(a, "a"), _checked_colors(b, "b")
    if projections < 1:
        raise ValueError(f"projections must be at least 1, got {projections}")
    directions = rng.standard_normal((projections, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    squares = [_squared_wasserstein(_project(first, d), _project(second, d)) for d in directions]
    return float(np.sqrt(np.mean(squares)))


def _checked_colors(colors: ArrayLike, name: str) -> Doubles:
    checked = np.asarray(colors, dtype=np.float64)
    if checked.ndim != 2 or checked.shape[1] != 3 or len(checked) == 0:
        raise ValueError(f"{name} must have the shape (n, 3) with n >= 1, got {checked.shape}")
    if not np.isfinite(checked).all():
        raise ValueError(f"{name} must be finite, but NaN or infinity was found")
    return checked


def _checked_weights(weights: ArrayLike | None, count: int) -> Doubles | None:
    """The masses, or None for equal ones."""
    if weights is None:
        return None
    checked = np.asarray(weights, dtype=np.float64)
    if checked.shape != (count,):
        raise ValueError(f"weights must have the shape ({count},), got {checked.shape}")
    if not (np.isfinite(checked).all() and (checked > 0).all()):
        raise ValueError("weights must be finite and positive")
    return checked


def _random_rotation(rng: np.random.Generator) -> Doubles:
    """A uniformly random orthonormal 3×3 matrix; the signs of diag R make the QR factor unique."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    signs: Doubles = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    return q * signs


def _project(rows: Doubles, direction: Doubles) -> Doubles:
    """rows @ direction, written out: a BLAS product may round equal rows differently by their position."""
    projected: Doubles = rows[:, 0] * direction[0] + rows[:, 1] * direction[1] + rows[:, 2] * direction[2]
    return projected


def _match(values: Doubles, mass: Doubles | None, target: Doubles) -> Doubles:
    """Each value's partner in `target` at the same quantile, in the order of `values`.

    The quantile of a value is (midrank − ½)/n, or with masses the middle of the mass that its ties hold together,
    so equal values get equal partners.
    """
    order = np.argsort(values)
    ordered = values[order]
    ends = np.append(np.flatnonzero(ordered[1:] != ordered[:-1]), len(ordered) - 1)
    cumulated = np.arange(1.0, len(order) + 1.0) if mass is None else np.cumsum(mass[order])
    upper = cumulated[ends]
    lower = np.concatenate(([0.0], upper[:-1]))
    quantiles = (lower + upper) / (2.0 * upper[-1])
    partners = np.interp(quantiles, (np.arange(len(target)) + 0.5) / len(target), np.sort(target))  # eq. (8)
    if len(ends) < len(order):
        partners = np.repeat(partners, np.diff(ends, prepend=-1))
    matched = np.empty_like(values)
    matched[order] = partners
    return matched


def _squared_wasserstein(values_a: Doubles, values_b: Doubles) -> float:
    """∫ (Q_a − Q_b)² over [0, 1] of the two stepwise quantile functions, exactly."""
    steps_a, steps_b = (np.arange(1.0, len(values) + 1.0) / len(values) for values in (values_a, values_b))
    steps = np.sort(np.concatenate((steps_a, steps_b)))
    widths = np.diff(steps, prepend=0.0)
    middles = steps - 0.5 * widths
    index_a = np.minimum(np.searchsorted(steps_a, middles), len(values_a) - 1)
    index_b = np.minimum(np.searchsorted(steps_b, middles), len(values_b) - 1)
    gaps = np.sort(values_a)[index_a] - np.sort(values_b)[index_b]
    return float(np.sum(widths * gaps**2))
